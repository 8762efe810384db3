"""What the texts are that an agent reports; it passes on whatever an adapter sends."""

from __future__ import annotations

from omm_cnc_bridge.control import Unseen
from omm_cnc_bridge.controls.mtconnect.meaning import Item

POINT = ("X", "Y", "Z")
FARTHEST = 1e7
"""No axis is farther from its zero (mm, rad): ten kilometres."""


def number(text: str) -> float | None:
    """Return a number; None where the text is none."""
    if "_" in text or not text.isascii():  # Python takes both for digits
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < FARTHEST else None


def why_not(value: float | None, text: str, item: Item) -> str:
    """Return why a text is no position of an axis; empty where it is one."""
    if value is None:
        return f"{text[:80]!r} is not a number"
    limits = item.limits
    if limits.least <= value <= limits.most:
        return ""
    return (
        f"{value:g} is outside what the agent's model allows ({limits.least:g} to {limits.most:g},"
        " Constraints)"
    )


def unseen(item: Item, text: str) -> dict[str, Unseen]:
    """Return what is hidden of the motion of the axes that a text tells of, by their names."""
    axes = POINT if item.role == "path" else (item.axis,)
    words = [*text.split(), *axes]  # a text that tells of fewer is no position, and refused for it
    hidden = {
        axis: item.limits.unseen_at(number(word) or 0.0, item.scale)
        for axis, word in zip(axes, words)
    }
    return {axis: value for axis, value in hidden.items() if value.why}


def line(text: str) -> int:
    """Return a program's line; -1 where the text is none."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
