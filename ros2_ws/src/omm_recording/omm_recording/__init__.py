"""The file of a run: written, read, sealed, verified, repaired (MCAP). Knows nothing of ROS."""
