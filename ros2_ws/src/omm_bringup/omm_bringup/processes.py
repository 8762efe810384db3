"""Nodes as processes: started, watched and ended together."""

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_prefix

from omm_core.errors import MeasurementError

_PR_SET_PDEATHSIG = 1
_END_S = 8.0


@dataclass(frozen=True, kw_only=True)
class NodeSpec:
    """One node: what `ros2 run PACKAGE EXECUTABLE` would start, with its name and parameters."""

    package: str
    executable: str
    name: str
    namespace: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    parameter_file: Path | None = None
    ends_first: bool = False
    """Whether it is ended, and waited for, before the others: it asks them for the end."""


@dataclass(frozen=True, kw_only=True)
class RunningNode:
    """A started node and where its output goes."""

    spec: NodeSpec
    process: "subprocess.Popen[bytes]"
    log_file: Path


def executable_of(spec: NodeSpec) -> Path:
    """Return the place where colcon has installed the executable of a node."""
    return Path(get_package_prefix(spec.package)) / "lib" / spec.package / spec.executable


@contextlib.contextmanager
def running(specs: Sequence[NodeSpec], log_folder: Path) -> Iterator[tuple[RunningNode, ...]]:
    """Start the nodes; at the end, however it comes, end them all.

    Raises
    ------
    MeasurementError
        At the end, when a node did not end cleanly: its last words are in the message.
    """
    log_folder.mkdir(parents=True, exist_ok=True)
    nodes: list[RunningNode] = []
    try:
        for spec in specs:
            nodes.append(_start(spec, log_folder))
        yield tuple(nodes)
    finally:
        _end(nodes)
    failed = [node for node in nodes if node.process.returncode != 0]
    if failed:
        raise MeasurementError(
            "\n".join(f"{n.spec.name} ended badly: {_last_words(n)}" for n in failed)
        )


def check_alive(nodes: Sequence[RunningNode]) -> None:
    """Raise MeasurementError, with the node's last words, when one has ended by itself."""
    for node in nodes:
        if node.process.poll() is not None:
            raise MeasurementError(
                f"{node.spec.name} ended by itself (status {node.process.returncode}): "
                f"{_last_words(node)}"
            )


def _start(spec: NodeSpec, log_folder: Path) -> RunningNode:
    label = f"{spec.namespace}/{spec.name}".lstrip("/").replace("/", "-")
    parameter_file = log_folder / f"{label}.parameters.yaml"
    full_name = f"{spec.namespace}/{spec.name}"
    parameters = {full_name: {"ros__parameters": dict(spec.parameters)}}
    parameter_file.write_text(yaml.safe_dump(parameters))
    log_file = log_folder / f"{label}.log"
    node_arguments = ["--ros-args", "-r", f"__node:={spec.name}"]
    node_arguments += ["-r", f"__ns:={spec.namespace}"] if spec.namespace else []
    with open(log_file, "wb") as log:
        process = subprocess.Popen(
            [
                str(executable_of(spec)),
                *node_arguments,
                *_given(spec),
                "--params-file",
                str(parameter_file),
            ],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "ROS_LOG_DIR": str(log_folder)},
            # A session of its own: Ctrl-C reaches us only, and we end the nodes in order.
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )
    return RunningNode(spec=spec, process=process, log_file=log_file)


def _given(spec: NodeSpec) -> list[str]:
    return ["--params-file", str(spec.parameter_file)] if spec.parameter_file else []


def _end_with_parent() -> None:
    """Have the kernel end the node when we are killed without a chance to do it (kill -9)."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _end(nodes: Sequence[RunningNode]) -> None:
    """End those that depend on others (the recorder) first, then the others in reverse order."""
    _end_together([node for node in nodes if node.spec.ends_first])
    _end_together([node for node in reversed(nodes) if not node.spec.ends_first])


def _end_together(nodes: Sequence[RunningNode]) -> None:
    for node in nodes:
        if node.process.poll() is None:
            node.process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _END_S
    for node in nodes:
        try:
            node.process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            node.process.kill()
            node.process.wait()


def _last_words(node: RunningNode) -> str:
    lines = node.log_file.read_text(errors="replace").strip().splitlines()
    return f"{' / '.join(lines[-5:]) or 'it said nothing'} (all of it: {node.log_file})"
