"""./omm keys: make keys with which only omm's nodes hear and speak to each other (SROS 2)."""

import argparse
from pathlib import Path

from omm_ros.keys import NODES, make_keystore


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="a new folder for the keys")
    parser.add_argument(
        "--nodes", nargs="+", default=list(NODES), metavar="NAME", help="default: %(default)s"
    )
    parser.epilog = (
        "Copy to each machine the folders public and enclaves, never private, by a way that nobody "
        "listens to. It needs a ROS installation; ROS 2 from wheels has no security. SECURITY.md."
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the keys, and say how nodes use them."""
    enclaves = make_keystore(arguments.folder, arguments.nodes)
    print(f"export ROS_SECURITY_KEYSTORE={arguments.folder.resolve()}")
    print("export ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce")
    for enclave in enclaves:
        print(f"# {enclave.rpartition('/')[2]}: --ros-args --enclave {enclave}")
    return 0
