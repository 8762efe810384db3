"""Estimator node of omm: images and spindle poses in, pose of the part out."""
