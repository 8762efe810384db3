"""Calibrate a camera in its tool holder: set, start, adjustment, what it leaves open."""
