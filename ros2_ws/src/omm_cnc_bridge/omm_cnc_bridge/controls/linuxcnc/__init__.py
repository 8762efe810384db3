"""LinuxCNC, read by a disposable child."""
