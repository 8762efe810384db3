"""Run by test_linuxcnc.py with LinuxCNC's Python: drive to poses, print joints and tool point."""

import os
import sys
import time

sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc

POSES = (
    "X0 Y0 Z0 B0 C0 W0",
    "X10 Y20 Z-30 B30 C0 W0",
    "X-5 Y7 Z11 B-45 C60 W0",
    "X3 Y-4 Z5 B80 C-120 W25",
    "X1 Y2 Z3 B12.345 C167.8 W-10",
)
status, command = linuxcnc.stat(), linuxcnc.command()
command.mode(linuxcnc.MODE_MANUAL)
command.wait_complete(5)
command.teleop_enable(1)
command.wait_complete(5)
command.mode(linuxcnc.MODE_MDI)
command.wait_complete(5)
for pose in POSES:
    command.mdi(f"G53 G0 {pose}")
    command.wait_complete(30)
    time.sleep(0.3)
    status.poll()
    joints, tool_point = status.joint_position[:6], status.position[:3]
    print(*(repr(v) for v in (*joints, *tool_point)), flush=True)
os._exit(0)
