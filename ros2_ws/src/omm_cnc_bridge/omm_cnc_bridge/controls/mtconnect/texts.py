"""What the texts are that an agent reports; it passes on whatever an adapter sends."""

from __future__ import annotations

from omm_cnc_bridge.controls.mtconnect.meaning import Item

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


def line(text: str) -> int:
    """Return a program's line; -1 where the text is none."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
