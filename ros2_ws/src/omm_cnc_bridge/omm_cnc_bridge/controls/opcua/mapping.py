"""Where an OPC UA server keeps what: by the names of OPC 40502, or as a file says.

A path is a list of browse names below the Objects folder, separated by ``/``; a name without a
namespace fits any. ``ns=…;s=…`` and ``nsu=URI;s=…`` are node ids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from omm_cnc_bridge.control import Mode, ProgramState
from omm_core.errors import InputError
from omm_core.files.declared import expect_once
from omm_core.files.yaml_input import YamlSection, read_yaml

TWICE = ("PosDirect", "PosIndirect")
"""Positions that OPC 40502 has of one axis; each is an item of its own until one is chosen."""
AXIS_ITEMS = ("position", "commanded", "status", "referenced")
CHANNEL_ITEMS = (
    "mode", "program_status", "program", "program_line", "measure_request", "spindle_angle"
)  # fmt: skip
OFFSET_ITEMS = ("X", "Y", "Z", "A", "B", "C")
CORRECTION_ITEMS = ("X", "Y", "Z", "status", "valid")
LENGTH_UNITS = ("mm", "m", "inch")
ANGLE_UNITS = ("rad", "deg")
UNITS = {
    "mm": 1.0,
    "um": 1e-3,
    "cm": 10.0,
    "m": 1000.0,
    "inch": 25.4,
    "rad": 1.0,
    "deg": 0.017453292519943295,
}


@dataclass(frozen=True, kw_only=True)
class AxisItems:
    """Nodes of one axis; ``position`` may be a structure with the fields ActPos and CmdPos."""

    paths: Mapping[str, str]
    unit: str | None = None
    """None takes the EngineeringUnits that the server tells."""
    in_position: int = 0
    """Value of ``status`` that means in position."""


@dataclass(frozen=True, kw_only=True)
class OffsetNodes:
    """Nodes of one work offset: X, Y, Z, and A, B, C about fixed x, y, z (where there are any)."""

    paths: Mapping[str, str]
    unit: str = "mm"
    angle_unit: str = "deg"


@dataclass(frozen=True, kw_only=True)
class CorrectionNodes:
    """Nodes of the next stop's correction: a shift of X, Y, Z, its status, and whether it holds."""

    paths: Mapping[str, str]
    unit: str = "mm"


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
    """Where the number of an image that is in is written."""
    offsets: Mapping[str, OffsetNodes] = field(default_factory=dict)
    """Work offsets by name."""
    correction: CorrectionNodes | None = None
    """With ``acknowledge`` and ``offsets`` the only nodes that are ever written."""


def load_mapping(path: Path) -> Mapping40502:
    """Read a mapping file, see the examples in the folder controls.

    Raises
    ------
    InputError
        Where the file is not there or says something unknown.
    """
    root = read_yaml(path, "mapping", strict=True)
    root.check_keys(
        "axes", "channel", "modes", "program_states", "acknowledge", "offsets", "correction"
    )
    axes = root.section("axes")
    if not axes.values:
        raise InputError(f"{axes.where}: expected at least one axis, got none.")
    given: dict[str, Any] = {}
    if "channel" in root:
        given["channel"] = _paths(root.section("channel"), CHANNEL_ITEMS)
    if "modes" in root:
        given["modes"] = _words(root.section("modes"), Mode)
    if "program_states" in root:
        given["program_states"] = _words(root.section("program_states"), ProgramState)
    if "acknowledge" in root:
        given["acknowledge"] = root.text("acknowledge")
    if "offsets" in root:
        given["offsets"] = _offsets(root.section("offsets"))
    if "correction" in root:
        given["correction"] = _correction(root.section("correction"))
    return Mapping40502(
        axes={str(name): _axis(axes.section(name)) for name in axes.values}, **given
    )


def _paths(section: YamlSection, items: tuple[str, ...]) -> dict[str, str]:
    section.check_keys(*items)
    return {item: section.text(item) for item in items if item in section}


def _words(section: YamlSection, words: type[Enum]) -> dict[int, str]:
    """Read what each number of the control means: a word of an enumeration."""
    known = [word.name for word in words]
    for number, word in section.values.items():
        if not isinstance(number, int) or word not in known:
            raise InputError(
                f"{section.where}: expected a number and one of the words {', '.join(known)},"
                f" got {str(number)[:80]}: {str(word)[:80]}."
            )
    return dict(section.values)


def _axis(entry: YamlSection) -> AxisItems:
    entry.check_keys(*AXIS_ITEMS, "unit", "in_position")
    if "position" not in entry:
        raise InputError(f"{entry.where}: expected the path of its position.")
    unit = entry.text("unit") if "unit" in entry else None
    if unit not in (None, *UNITS):
        raise InputError(f"{entry.where}: expected a unit of {', '.join(UNITS)}, got {unit}.")
    return AxisItems(
        paths={item: entry.text(item) for item in AXIS_ITEMS if item in entry},
        unit=unit,
        in_position=entry.integer("in_position") if "in_position" in entry else 0,
    )


def _offsets(section: YamlSection) -> dict[str, OffsetNodes]:
    found = {str(name): _offset(section.section(name)) for name in section.values}
    nodes = [path for offset in found.values() for path in offset.paths.values()]
    expect_once(nodes, section.where, "node")
    return found


def _offset(section: YamlSection) -> OffsetNodes:
    section.check_keys(*OFFSET_ITEMS, "unit", "angle_unit", "angles")
    paths = {item: section.text(item) for item in OFFSET_ITEMS if item in section}
    if missing := [item for item in OFFSET_ITEMS[:3] if item not in paths]:
        raise InputError(f"{section.where}: expected nodes for {', '.join(missing)}, too.")
    chosen = {
        "unit": ("mm", LENGTH_UNITS),
        "angle_unit": ("deg", ANGLE_UNITS),
        "angles": ("rpy", ("rpy",)),
    }
    told = {n: section.text(n) if n in section else default for n, (default, _) in chosen.items()}
    for name, (_, words) in chosen.items():
        if told[name] not in words:
            raise InputError(
                f"{section.where}: expected {name} to be one of {', '.join(words)}, got"
                f" {told[name]}."
            )
    return OffsetNodes(paths=paths, unit=told["unit"], angle_unit=told["angle_unit"])


def _correction(section: YamlSection) -> CorrectionNodes:
    section.check_keys(*CORRECTION_ITEMS, "unit")
    paths = {item: section.text(item) for item in CORRECTION_ITEMS if item in section}
    if missing := [item for item in CORRECTION_ITEMS if item not in paths]:
        raise InputError(f"{section.where}: expected nodes for {', '.join(missing)}, too.")
    if len(set(paths.values())) != len(paths):
        raise InputError(f"{section.where}: expected each node once, got one of them twice.")
    unit = section.text("unit") if "unit" in section else "mm"
    if unit not in LENGTH_UNITS:
        raise InputError(
            f"{section.where}: expected unit to be one of {', '.join(LENGTH_UNITS)}, got {unit}."
        )
    return CorrectionNodes(paths=paths, unit=unit)
