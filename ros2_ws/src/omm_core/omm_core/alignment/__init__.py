"""From the part's pose to what someone does about it: words of a control, corrections of jacks.

``handover`` puts a pose into a control's own words and tells what they cannot say;
``controls`` holds each control's words; ``jacks`` says how far to turn which jack.
"""
