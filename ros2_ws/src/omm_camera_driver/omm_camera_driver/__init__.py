"""Camera node of omm: GigE Vision, V4L2 or simulated."""
