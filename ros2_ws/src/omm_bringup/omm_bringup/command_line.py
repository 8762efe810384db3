"""The command line: `./omm COMMAND …`.

Exit status 0 = done, 1 = the measurement failed (told why), 2 = bad input or usage.
"""

import argparse
import importlib
import io
import os
import pkgutil
import sys
from typing import Any

from omm_bringup import commands
from omm_bringup.values import guard
from omm_core.errors import InputError, OmmError
from omm_core.printable import printable

COMMANDS = tuple(sorted(module.name for module in pkgutil.iter_modules(commands.__path__)))


def summary(name: str) -> str:
    """Return what a command does: the first line of its module, behind the colon."""
    module = importlib.import_module(f"omm_bringup.commands.{name}")
    first = (module.__doc__ or "").strip().splitlines()[0]
    return first.partition(": ")[2].rstrip(".")


def main(arguments: list[str] | None = None) -> int:
    """Run one command; errors become one line and an exit status."""
    for stream in (sys.stdout, sys.stderr):
        # Names of files need not be UTF-8: they are told as the bytes that they are.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="surrogateescape")
    arguments = sys.argv[1:] if arguments is None else arguments
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        return _usage(name)
    command = importlib.import_module(f"omm_bringup.commands.{name}")
    parser = argparse.ArgumentParser(
        prog=f"./omm {name}",
        description=f"{summary(name)[:1].upper()}{summary(name)[1:]}".rstrip("?.") + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    guard(parser)
    plain = sys.stdout
    sys.stdout = Printable(plain)
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
    except OSError as error:
        # A folder that may not be entered, a full disk, a name too long: no fault of omm's.
        name = f"{error.filename}: " if error.filename is not None else ""
        return _failed(InputError(f"{name}{error.strerror or error}."), 2)
    except MemoryError:
        return _failed(InputError("There is not enough memory for what was given."), 2)
    finally:
        sys.stdout = plain


def _failed(error: OmmError, status: int) -> int:
    print(f"omm: {printable(str(error))}", file=sys.stderr)
    return status


class Printable:
    """Standard output on which nothing that stood in a file steers the terminal."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text, escaped where it would steer the terminal."""
        return int(self._stream.write(printable(text)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _usage(name: str) -> int:
    if name and name not in ("-h", "--help", "help"):
        print(f"omm: there is no command {name!r}.", file=sys.stderr)
    print("Usage: ./omm COMMAND [--help]\n", file=sys.stderr)
    for command in COMMANDS:
        print(f"  {command:<14} {summary(command)}", file=sys.stderr)
    return 0 if name in ("-h", "--help", "help") else 2


if __name__ == "__main__":
    sys.exit(main())
