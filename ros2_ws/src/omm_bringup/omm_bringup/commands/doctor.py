"""`./omm doctor`: what is installed, what is missing, how to get it, and what works without."""

import argparse
import ctypes
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

# An image of 5 MB comes as fast as the network brings it: the socket must hold what the computer
# has not read yet (measured: with the default nearly all images miss packets).
_USB_MEMORY_MB = 128
_SOCKET_BUFFER_BYTES = 4_000_000


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked for.

    Attributes
    ----------
    needed : bool
        False: only for what `purpose` says.
    remedy : str
        What to type on Debian and Ubuntu.
    without : str
        What works all the same.
    """

    name: str
    there: bool
    needed: bool
    purpose: str
    remedy: str
    without: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--json", action="store_true", help="machine-readable, on standard output")


def run(args: argparse.Namespace) -> int:
    """Print the findings; exit 1 if something required is missing."""
    findings = look()
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=1))
    else:
        for finding in findings:
            print(_told(finding))
    return 1 if any(f.needed and not f.there for f in findings) else 0


def look() -> list[Finding]:
    """Return everything that omm can use of the system."""
    return [
        _tool("c++", "builds the ROS messages", "sudo apt install g++", needed=True),
        _tool("cmake", "builds the ROS messages", "sudo apt install cmake make", needed=True),
        _ros(),
        _finding(
            "libaravis",
            lambda: _loads("libaravis-0.8.so.0"),
            "GigE Vision cameras, real and simulated, and USB3 Vision cameras",
            "sudo apt install libaravis-0.8-0",
            "V4L2 cameras and the simulated cell (./omm demo)",
        ),
        _finding(
            "socket buffers",
            lambda: _largest_socket_buffer() >= _SOCKET_BUFFER_BYTES,
            "GigE Vision cameras without lost packets",
            f"sudo sysctl -w net.core.rmem_max={2 * _SOCKET_BUFFER_BYTES}",
            "slow or small images; all others lose packets",
        ),
        _finding(
            "USB memory",
            lambda: _usb_memory_mb() >= _USB_MEMORY_MB,
            "USB3 Vision cameras of several megapixels",
            f"usbcore.usbfs_memory_mb={2 * _USB_MEMORY_MB} on the kernel's command line",
            "small images; large ones get lost",
        ),
        _finding(
            "video devices",
            _may_use_video,
            "V4L2 cameras: the right to open /dev/video*",
            "sudo usermod -aG video $USER, then log in again",
            "GigE Vision cameras and the simulated cell",
        ),
        _tool(
            "linuxcnc",
            "a real control with simulated drives (./omm demo --control linuxcnc)",
            "sudo apt install linuxcnc-uspace",
            without="the simulated control, and controls on the network",
        ),
        _tool(
            "qemu-system-x86_64",
            "tests of V4L2 and USB3 cameras in a virtual machine (./omm test)",
            "sudo apt install qemu-system-x86 busybox-static kmod cpio",
            without="everything but that test, which is skipped",
        ),
        _finding(
            "shared memory",
            lambda: _free_bytes("/dev/shm") > 300_000_000,
            "large images between processes",
            "sudo mount -o remount,size=1G /dev/shm (in a container: --shm-size=1g)",
            "images through UDP, of which some get lost",
        ),
    ]


def _told(finding: Finding) -> str:
    mark = "ok     " if finding.there else "MISSING" if finding.needed else "without"
    line = f"{mark} {finding.name:<20} {finding.purpose}"
    if finding.there:
        return line
    lines = [line, f"{'':8}to get it: {finding.remedy}"]
    if finding.without:
        lines.append(f"{'':8}works without: {finding.without}")
    return "\n".join(lines)


def _finding(
    name: str,
    test: Callable[[], bool],
    purpose: str,
    remedy: str,
    without: str = "",
    *,
    needed: bool = False,
) -> Finding:
    return Finding(
        name=name, there=test(), needed=needed, purpose=purpose, remedy=remedy, without=without
    )


def _tool(
    name: str, purpose: str, remedy: str, without: str = "", *, needed: bool = False
) -> Finding:
    return _finding(
        name, lambda: shutil.which(name) is not None, purpose, remedy, without, needed=needed
    )


def _ros() -> Finding:
    sourced = os.environ.get("ROS_VERSION") == "2" and Path("/opt/ros/jazzy").is_dir()
    return Finding(
        name="ROS 2 Jazzy",
        there=sourced,
        needed=False,
        purpose="ros2 command, launch files, rqt, rviz",
        remedy="https://docs.ros.org/en/jazzy/Installation.html, then source its setup.bash",
        without="everything of omm: ./omm brings ROS 2 from wheels",
    )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _largest_socket_buffer() -> int:
    return int(Path("/proc/sys/net/core/rmem_max").read_text())


def _usb_memory_mb() -> int:
    told = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
    # 0 means no limit; a computer without USB has nothing to be short of.
    return (int(told.read_text()) if told.exists() else 0) or _USB_MEMORY_MB


def _may_use_video() -> bool:
    return all(os.access(path, os.R_OK | os.W_OK) for path in Path("/dev").glob("video*"))


def _free_bytes(folder: str) -> int:
    return shutil.disk_usage(folder).free if Path(folder).is_dir() else 0
