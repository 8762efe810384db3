"""Geometry, target detection, estimation and uncertainty of omm. Knows nothing of ROS."""
