"""Recorded runs solved again, one or many, and taken apart. Knows nothing of ROS."""
