"""Where an OPC UA server keeps what: by the names of OPC 40502, or as a file says.

A path is a list of browse names below the Objects folder, separated by ``/``; a name without a
namespace fits any. ``ns=…;s=…`` and ``nsu=URI;s=…`` are node ids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from omm_core.errors import InputError

TWICE = ("PosDirect", "PosIndirect")
"""Positions that OPC 40502 has of one axis; each is an item of its own until one is chosen."""
AXIS_ITEMS = ("position", "commanded", "status", "referenced")
CHANNEL_ITEMS = (
    "mode", "program_status", "program", "program_line", "measure_request", "spindle_angle"
)  # fmt: skip
ANGLE_UNITS = ("rad", "deg")
UNITS = {"mm": 1.0, "m": 1000.0, "inch": 25.4, "rad": 1.0, "deg": 0.017453292519943295}


@dataclass(frozen=True, kw_only=True)
class AxisItems:
    """Nodes of one axis; ``position`` may be a structure with the fields ActPos and CmdPos."""

    paths: Mapping[str, str]
    unit: str | None = None
    """None takes the EngineeringUnits that the server tells."""
    in_position: int = 0
    """Value of ``status`` that means in position."""


@dataclass(frozen=True, kw_only=True)
class Mapping40502:
    """What is read, from where; an empty mapping is found by browsing for OPC 40502's names."""

    axes: Mapping[str, AxisItems] = field(default_factory=dict)
    channel: Mapping[str, str] = field(default_factory=dict)
    modes: Mapping[int, str] = field(
        default_factory=lambda: {0: "MANUAL", 1: "MDI", 2: "AUTOMATIC"}
    )
    program_states: Mapping[int, str] = field(
        default_factory=lambda: {
            0: "STOPPED", 1: "RUNNING", 2: "WAITING", 3: "INTERRUPTED", 4: "INTERRUPTED"
        }
    )  # fmt: skip
    acknowledge: str = ""
    """Where the number of an image that is in is written; the only thing ever written."""


def load_mapping(path: Path) -> Mapping40502:
    """Read a mapping file, see the examples in the folder controls.

    Raises
    ------
    InputError
        Where the file is not there or says something unknown.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"Expected a mapping at {path}: {error}") from error
    known = {"axes", "channel", "modes", "program_states", "acknowledge"}
    if not isinstance(document, dict) or not document.get("axes") or set(document) - known:
        raise InputError(f"{path}: expected axes and optionally {', '.join(sorted(known))}.")
    channel = document.get("channel") or {}
    if set(channel) - set(CHANNEL_ITEMS):
        raise InputError(f"{path}: channel: expected some of {', '.join(CHANNEL_ITEMS)}.")
    axes = {str(n): _axis(a, f"{path}: axis {n}") for n, a in document["axes"].items()}
    given = {key: document[key] for key in known - {"axes"} if key in document}
    return Mapping40502(axes=axes, **given)


def _axis(entry: Any, where: str) -> AxisItems:
    options = {"unit", "in_position"}
    if not isinstance(entry, dict) or set(entry) - {*AXIS_ITEMS, *options}:
        raise InputError(f"{where}: expected some of {', '.join((*AXIS_ITEMS, *sorted(options)))}.")
    if "position" not in entry:
        raise InputError(f"{where}: expected the path of its position.")
    if entry.get("unit") not in (None, *UNITS):
        raise InputError(f"{where}: expected a unit of {', '.join(UNITS)}, got {entry['unit']}.")
    paths = {item: entry[item] for item in AXIS_ITEMS if item in entry}
    return AxisItems(
        paths=paths, unit=entry.get("unit"), in_position=int(entry.get("in_position", 0))
    )
