"""The machine: its description, its kinematics, checked and drawn."""
