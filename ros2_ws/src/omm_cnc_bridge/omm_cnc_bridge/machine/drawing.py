"""Draws a machine's description as SVG: the chain of joints, their axes and travels, isometric."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from omm_core.machine.kinematics import Kinematics, Side
from omm_core.machine.urdf import Joint

Array = NDArray[np.float64]
_WIDTH, _HEIGHT, _MARGIN = 900.0, 700.0, 70.0
_COLOURS = {Side.TOOL: "#1f6feb", Side.PART: "#d29922"}
_COS, _SIN = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))


def draw(machine: Kinematics) -> str:
    """Return an SVG document of the machine with all axes at zero."""
    lines, labels = _lines(machine)
    points = np.array([p for a, b, _ in lines for p in (a, b)])
    to_page = _page(points)
    body = [
        _line(to_page(_isometric(a)), to_page(_isometric(b)), style) for a, b, style in lines
    ] + [_label(to_page(_isometric(at)), text, colour) for at, text, colour in labels]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" '
        f'font-family="sans-serif" font-size="15"><rect width="100%" height="100%" fill="white"/>'
        f'<text x="20" y="30" font-size="20">{machine.name}</text>'
        f'<text x="20" y="{_HEIGHT - 20:g}">blue moves the tool, amber the part; thin: travel, '
        f"dashed: turn</text>{''.join(body)}</svg>\n"
    )


def _lines(
    machine: Kinematics,
) -> tuple[list[tuple[Array, Array, str]], list[tuple[Array, str, str]]]:
    """Return the segments (from, to, style) in mm, and the labels (at, text, colour)."""
    sides = {axis.name: axis.side for axis in machine.axes}
    poses = _poses(machine)
    size = max(300.0, max(float(np.linalg.norm(p[:3, 3])) for p in poses.values()))
    segments = [(np.zeros(3), 0.2 * size * e, "black;2") for e in np.eye(3)]
    labels = [(0.22 * size * e, f"+{n} machine", "black") for e, n in zip(np.eye(3), "XYZ")]
    for joint in machine.robot.joints:
        parent, child = poses[joint.parent], poses[joint.child]
        segments.append((parent[:3, 3], child[:3, 3], "#57606a;5"))
        if joint.movable:
            colour = _COLOURS[sides.get(joint.name, Side.TOOL)]
            direction = child[:3, :3] @ joint.axis
            segments += _travel(joint, child[:3, 3], direction, colour, size)
            labels.append((child[:3, 3] + 0.2 * size * direction, f"+{joint.name}", colour))
    tip = poses["spindle"]
    segments.append((tip[:3, 3], tip[:3, 3] - 0.25 * size * tip[:3, 2], "#cf222e;3"))
    labels.append((tip[:3, 3] - 0.27 * size * tip[:3, 2], "tool", "#cf222e"))
    return segments, labels


def _poses(machine: Kinematics) -> dict[str, Array]:
    """Return every link's homogeneous pose at zero, mm."""
    poses = {machine.robot.root: np.eye(4)}
    waiting = list(machine.robot.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in poses]
        for joint in ready:
            poses[joint.child] = poses[joint.parent] @ joint.origin
        waiting = [joint for joint in waiting if joint.child not in poses]
    return poses


def _travel(
    joint: Joint, origin: Array, direction: Array, colour: str, size: float
) -> list[tuple[Array, Array, str]]:
    arrow = (origin, origin + 0.18 * size * direction, f"{colour};4")
    if joint.rotary:
        return [arrow, (origin, origin - 0.1 * size * direction, f"{colour};2;6 4")]
    ends = origin + joint.lower * direction, origin + joint.upper * direction
    return [arrow, (*ends, f"{colour};1")]


def _isometric(p: Array) -> Array:
    """Return the projection: X to the lower right, Y to the upper right, Z up; y points down."""
    return np.array([_COS * (p[0] + p[1]), _SIN * (p[0] - p[1]) - p[2]])


def _page(points: Array) -> Callable[[Array], Array]:
    flat = np.array([_isometric(p) for p in points])
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array([_WIDTH - 2 * _MARGIN, _HEIGHT - 2 * _MARGIN])
    scale = float(np.min(room / np.maximum(high - low, 1.0)))
    middle = np.array([_WIDTH, _HEIGHT]) / 2.0

    def to_page(p: Array) -> Array:
        return np.asarray(middle + scale * (p - (low + high) / 2.0))

    return to_page


def _line(a: Array, b: Array, style: str) -> str:
    colour, width, *dashes = style.split(";")
    dash = f' stroke-dasharray="{dashes[0]}"' if dashes else ""
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" '
        f'stroke="{colour}" stroke-width="{width}" stroke-linecap="round"{dash}/>'
    )


def _label(at: Array, text: str, colour: str) -> str:
    return f'<text x="{at[0] + 4:.1f}" y="{at[1] - 4:.1f}" fill="{colour}">{text}</text>'
