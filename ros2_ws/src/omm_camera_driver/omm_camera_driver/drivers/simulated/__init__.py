"""The camera of the simulated cell."""
