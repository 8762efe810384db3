"""LinuxCNC's work offsets: the blocks that set them, and what its status tells of them.

LinuxCNC turns about Z only (G10 L2's R); a tilt is refused here, whoever asks. Its block is made of
numbers and of a name out of a fixed list, of nothing else.
"""

from __future__ import annotations

import math
from typing import Any

from omm_cnc_bridge.control import WorkOffset
from omm_core.errors import DeviceError
from omm_core.words import keyed

NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
LARGEST_MM = 100_000.0
LARGEST_TILT_RAD = 1e-9
_EQUAL_MM, _EQUAL_DEG = 1e-5, 1e-7
_INCH, _INCREMENTAL = 200, 910  # G20, G91 in LinuxCNC's count


def block(status: dict[str, Any], offset: WorkOffset) -> str:
    """Return the block that sets an offset, whatever units and distance mode are active.

    Raises
    ------
    DeviceError
        Where LinuxCNC has no such offset or cannot say it, or G92 is set on top of it.
    """
    number = _number(offset.name)
    a, b, c = offset.euler_xyz_rad
    values = (*offset.xyz_mm, math.degrees(c))
    if not all(math.isfinite(v) for v in (*values, a, b)) or max(map(abs, values)) > LARGEST_MM:
        raise DeviceError(
            keyed(
                "said.offset_too_large",
                "Expected numbers within ±{mm} mm, got {got}.",
                mm=f"{LARGEST_MM:g}",
                got=str(offset.xyz_mm),
            )
        )
    if max(abs(a), abs(b)) > LARGEST_TILT_RAD:
        raise DeviceError(
            keyed(
                "said.turns_about_z",
                "LinuxCNC turns about Z only, got a tilt of {x}, {y} mm/m.",
                x=f"{1e3 * a:.6f}",
                y=f"{1e3 * b:.6f}",
            )
        )
    if any(abs(value) > 0.0 for value in status.get("g92") or ()):
        raise DeviceError(
            keyed(
                "said.g92",
                "G92 is set and would be added: clear it (G92.1), then hand over again.",
            )
        )
    x, y, z, turn = (f"{value + 0.0:.9f}" for value in values)
    return f"G21 G90 G10 L2 P{number} X{x} Y{y} Z{z} R{turn}"


def restoring(before: dict[str, Any]) -> list[str]:
    """Return the blocks that make active again what was active before."""
    codes = before.get("gcodes") or ()
    words = [word for code, word in ((_INCH, "G20"), (_INCREMENTAL, "G91")) if code in codes]
    index = (before.get("g5x") or [0])[0]
    return [*words, *([NAMES[index - 1]] if 1 <= index <= len(NAMES) else [])]


def read(status: dict[str, Any], name: str, per_mm: float) -> WorkOffset:
    """Return an offset as the status tells it.

    Raises
    ------
    DeviceError
        Where it is not the active one, of which alone LinuxCNC tells.
    """
    _number(name)
    found = told(status, name, per_mm)
    if found is None:
        active = (status.get("g5x") or [0])[0]
        other = NAMES[active - 1] if 1 <= active <= len(NAMES) else "none"
        raise DeviceError(
            keyed(
                "said.other_active",
                "LinuxCNC reports an offset only while it is active: {other} is.",
                other=other,
            )
        )
    return found


def told(status: dict[str, Any], name: str, per_mm: float) -> WorkOffset | None:
    """Return an offset as the status tells it; None where another one is active."""
    index, values, turn = status.get("g5x") or (0, (), 0.0)
    if index != _number(name):
        return None
    x, y, z = (float(value) / per_mm for value in values[:3])
    return WorkOffset(name=name, xyz_mm=(x, y, z), euler_xyz_rad=(0.0, 0.0, math.radians(turn)))


def equal(one: WorkOffset, other: WorkOffset) -> bool:
    """Return whether two offsets are equal to the precision that LinuxCNC keeps."""
    moved = max(abs(a - b) for a, b in zip(one.xyz_mm, other.xyz_mm, strict=True))
    turned = math.degrees(one.euler_xyz_rad[2] - other.euler_xyz_rad[2])
    return moved <= _EQUAL_MM and abs(math.remainder(turned, 360.0)) <= _EQUAL_DEG


def _number(name: str) -> int:
    if name not in NAMES:
        raise DeviceError(f"Expected an offset of LinuxCNC: {', '.join(NAMES)}; got {name!r}.")
    return NAMES.index(name) + 1
