"""The simulated cell: a machine that moves, a camera that renders. Knows nothing of ROS."""
