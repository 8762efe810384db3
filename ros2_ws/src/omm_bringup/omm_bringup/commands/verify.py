"""./omm verify: check that a recording is as it was recorded."""

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("run", metavar="RUN", type=Path, help="an MCAP file or a run's folder")
    parser.add_argument(
        "--key",
        metavar="PUBLIC_KEY",
        help="the shop's public key, in 64 hexadecimal digits or a file: only its signature counts",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the verdict; status 1 where the recording was changed."""
    from omm_core.printable import printable
    from omm_recording.run_files import find_run
    from omm_recording.seal import public_key
    from omm_recording.verifying import verify

    trusted = None if arguments.key is None else public_key(arguments.key)
    status = 0
    for path in find_run(arguments.run).recordings:
        verdict = verify(path, trusted)
        for problem in verdict.problems:
            print(printable(f"omm: {path}: {problem}"), file=sys.stderr)
        if not verdict.intact:
            status = 1
            print(f"omm: {path} is NOT as it was recorded.", file=sys.stderr)
            continue
        print(
            f"{path} is as it was recorded ({verdict.size_bytes} bytes, {verdict.blocks} blocks)."
        )
        print(f"sha256  {verdict.sha256}")
        if verdict.signed:
            print(f"signed  by {verdict.public_key}")
        else:
            print("signed  by nobody: who wants to deceive could have sealed it anew")
    return status
