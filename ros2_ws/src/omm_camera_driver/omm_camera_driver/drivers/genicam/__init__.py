"""Cameras that describe themselves by GenICam, through Aravis: what their links have in common."""
