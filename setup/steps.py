"""Steps of the set-up, done once and shown as they go."""

import re
import subprocess
import sys
import time
from pathlib import Path


class SetupError(Exception):
    """Something is missing that omm cannot bring itself, or a step failed."""


def step(home: Path, name: str, state: str, work, title: str) -> None:
    """Do `work` unless it was finished for the same `state` before."""
    stamp = home / f"{name}.done"
    if stamp.is_file() and stamp.read_text() == state:
        return
    stamp.unlink(missing_ok=True)
    log = home / "setup.log"
    start = time.monotonic()
    say(f"{title} …", end="")
    try:
        work(log)
    except subprocess.CalledProcessError as error:
        tail = "".join(log.read_text(errors="replace").splitlines(keepends=True)[-15:])
        raise SetupError(
            f"{title}: failed (status {error.returncode}). The end of {log}:\n{tail}"
        ) from None
    say(f"{title} ({time.monotonic() - start:.0f} s)", again=True)
    write_whole(stamp, state)


def call(
    command: list[str], log: Path, environment: dict[str, str], title="", counted="", total=0
) -> None:
    """Run a command with its output in the log; lines that match `counted` move the progress."""
    count = 0
    with open(log, "a") as file:
        file.write(f"\n$ {' '.join(command)}\n")
        file.flush()
        with subprocess.Popen(
            command,
            env=environment,
            cwd=log.parent,  # modules of the user's folder are none of ours
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        ) as process:
            for line in process.stdout or ():
                file.write(line)
                if counted and re.match(counted, line):
                    count += 1
                    say(f"{title} … {min(count, total)} of {total}", end="", again=True)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)


def say(text: str, end: str = "\n", again: bool = False) -> None:
    """Print one line a step on a terminal (rewritten as it goes on); elsewhere only final ones."""
    if sys.stderr.isatty():
        print(("\r\033[K" if again else "") + f"omm: {text}", end=end, file=sys.stderr, flush=True)
    elif end == "\n":
        print(f"omm: {text}", file=sys.stderr, flush=True)


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is either there in whole or not at all."""
    temporary = path.with_name(path.name + ".new")
    temporary.write_text(text)
    temporary.replace(path)
