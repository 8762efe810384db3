"""How a point in front of the camera becomes a pixel: lens, circle, calibration."""
