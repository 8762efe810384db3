"""The control of the simulated cell."""
