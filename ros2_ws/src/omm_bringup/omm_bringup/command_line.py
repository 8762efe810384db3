"""The command line: `./omm COMMAND …`.

Exit status 0 = done, 1 = the measurement failed (told why), 2 = bad input or usage.
"""

import argparse
import importlib
import os
import sys

from omm_core.errors import InputError, OmmError

COMMANDS = {
    "demo": "measure a part in a simulated cell and show the result beside the truth",
    "solve": "solve a recording again, without ROS running",
    "replay": "publish a recording to the live nodes",
    "detect": "find coded targets in photographs",
    "targets": "make a printable sheet of coded targets",
    "repeatability": "6D against 7D over many clampings, as in the paper",
    "info": "what is in a recording",
    "export": "images and tables out of a recording",
    "repair": "make a recording that was cut short readable",
    "verify": "is a recording as it was recorded?",
    "cameras": "which cameras are there",
    "machine": "show and check the description of a machine",
    "doctor": "what is installed, what is missing, how to get it",
}


def main(arguments: list[str] | None = None) -> int:
    """Run one command; errors become one line and an exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        return _usage(name)
    command = importlib.import_module(f"omm_bringup.commands.{name}")
    parser = argparse.ArgumentParser(
        prog=f"./omm {name}",
        description=f"{COMMANDS[name][0].upper()}{COMMANDS[name][1:]}".rstrip("?.") + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    try:
        return int(command.run(parser.parse_args(arguments[1:])))
    except InputError as error:
        return _failed(error, 2)
    except OmmError as error:
        return _failed(error, 1)
    except KeyboardInterrupt:
        print("\nomm: interrupted.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`| head`): nothing is left to tell it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _failed(error: OmmError, status: int) -> int:
    print(f"omm: {error}", file=sys.stderr)
    return status


def _usage(name: str) -> int:
    if name and name not in ("-h", "--help", "help"):
        print(f"omm: there is no command {name!r}.", file=sys.stderr)
    print("Usage: ./omm COMMAND [--help]\n", file=sys.stderr)
    for command, summary in COMMANDS.items():
        print(f"  {command:<14} {summary}", file=sys.stderr)
    return 0 if name in ("-h", "--help", "help") else 2


if __name__ == "__main__":
    sys.exit(main())
