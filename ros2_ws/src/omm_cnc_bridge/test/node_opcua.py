"""Starts node_opcua_server.js, where node-opcua is installed."""

import contextlib
import functools
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path


@functools.cache
def environment() -> dict[str, str]:
    """In which node finds what was installed globally."""
    found = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True, check=False)
    return {"NODE_PATH": found.stdout.strip(), **os.environ}


def is_installed() -> bool:
    """Whether node-opcua and its nodesets are on this machine."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return False
    look = "require.resolve('node-opcua'); require.resolve('node-opcua-nodesets')"
    done = subprocess.run(["node", "-e", look], env=environment(), capture_output=True, check=False)
    return done.returncode == 0


def command(port: int, *options: str) -> list[str]:
    """What starts the server."""
    return ["node", str(Path(__file__).with_name("node_opcua_server.js")), str(port), *options]


@contextlib.contextmanager
def node_opcua_server(port: int, *options: str) -> "Iterator[subprocess.Popen[str]]":
    """The running server; see the script for the options."""
    with subprocess.Popen(
        command(port, *options), env=environment(), stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert "ready\n" in process.stdout  # reads until then; node-opcua has other things to say
        try:
            yield process
        finally:
            process.kill()
