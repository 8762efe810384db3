"""CNC bridge node of omm: LinuxCNC, OPC UA, MTConnect or simulated."""
