"""What a measuring program does, in no control's words: where it goes and asks for images."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.machine.kinematics import Kinematics
from omm_core.planning.touch import Touch

Array = NDArray[np.float64]

_FARTHEST_MM = 100_000.0
# What may be written into a program, and nothing else.
_RANGES = (
    ("retract_mm", 0.0, _FARTHEST_MM),
    ("dwell_s", 0.0, 600.0),
    ("feed_mm_per_min", 1.0, 1_000_000.0),
    ("answer_timeout_s", 0.1, 3600.0),
    ("limit_mm", 0.0, 10_000.0),
    ("tries", 1, 1000),
)


@dataclass(frozen=True, kw_only=True)
class ProgramOptions:
    """How the stops are gone to.

    Attributes
    ----------
    retract_mm : float
        How far beyond the farthest stop the spindle is out, along its axis, before the first.
    dwell_s : float
        Rest before an image is asked for.
    limit_mm : float
        Largest correction of a stop, each axis, that the program takes from outside; 0: none.
    tries : int
        Images that are taken for one stop where nothing is seen, each somewhere else.
    """

    retract_mm: float = 100.0
    dwell_s: float = 0.3
    feed_mm_per_min: float = 10000.0
    answer_timeout_s: float = 20.0
    limit_mm: float = 0.0
    tries: int = 1

    def __post_init__(self) -> None:
        for name, lowest, highest in _RANGES:
            value = getattr(self, name)
            if not lowest <= value <= highest:  # false for NaN, too
                raise InputError(
                    f"Expected {name} between {lowest:g} and {highest:g} for a measuring program,"
                    f" got {value:g}."
                )


@dataclass(frozen=True, kw_only=True, eq=False)
class ProgramStop:
    """One stop: axis positions (mm, rad), and the ways out of the one before and in to this.

    Attributes
    ----------
    leave, arrive : tuple of mapping
        Positions on the way, those that belong to the stop before and those of this one.
    look : bool
        A look for the part: the program ends where it shows nothing, or nobody says what.
    """

    axes: Mapping[str, float]
    label: str
    leave: tuple[Mapping[str, float], ...] = ()
    arrive: tuple[Mapping[str, float], ...] = ()
    look: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """A measuring program.

    Attributes
    ----------
    clear, away : mapping
        The axis that goes out first, and how far: ``{"Z": 500}``; the same at the end.
    outward : float
        +1 where larger values of the first of them are farther out, else -1.
    rotary : frozenset of str
    touch : Touch, optional
        A height to touch when the images are done.
    """

    title: str
    stops: tuple[ProgramStop, ...]
    clear: Mapping[str, float]
    away: Mapping[str, float]
    outward: float
    rotary: frozenset[str]
    options: ProgramOptions = field(default_factory=ProgramOptions)
    touch: Touch | None = None


def make_program(
    kinematics: Kinematics,
    stops: Sequence[ProgramStop],
    options: ProgramOptions | None = None,
    *,
    title: str = "measure",
    free: Callable[[Mapping[str, float], str], float] | None = None,
) -> Program:
    """Return the program of stops.

    Parameters
    ----------
    free : callable, optional
        Position of an axis from which on, at a stop, the camera is beyond the part.

    Raises
    ------
    InputError
        Where there is no stop, or one is no place.
    """
    options = options or ProgramOptions()
    if not stops:
        raise InputError(
            "Expected stops for a measuring program, got none. Does the part have targets?"
        )
    for stop in stops:
        for axes in (*stop.leave, *stop.arrive, stop.axes):
            for name, value in axes.items():
                if not abs(value) <= _FARTHEST_MM:
                    raise InputError(
                        f"Expected places within {_FARTHEST_MM:g} mm for a measuring program, got"
                        f" {name} = {value} for {stop.label}."
                    )
    name, outward = tool_axis(kinematics, stops[0].axes)
    return Program(
        title=comment(title),
        stops=tuple(stops),
        clear=_clear(kinematics, stops, stops[0], options, free),
        away=_clear(kinematics, stops, stops[-1], options, free),
        outward=outward,
        rotary=kinematics.rotary,
        options=options,
    )


def _clear(
    kinematics: Kinematics,
    stops: Sequence[ProgramStop],
    stop: ProgramStop,
    options: ProgramOptions,
    free: Callable[[Mapping[str, float], str], float] | None,
) -> dict[str, float]:
    """Return how far the axis along the tool goes out: beyond all stops, within its limits."""
    name, outward = tool_axis(kinematics, stop.axes)
    places = [outward * other.axes[name] for other in stops]
    farthest = max(places) + options.retract_mm + options.limit_mm
    if free is not None:
        farthest = max(farthest, outward * free(stop.axes, name) + options.limit_mm)
    axis = next(axis for axis in kinematics.axes if axis.name == name)
    return {name: float(np.clip(outward * farthest, axis.lower, axis.upper))}


def tool_axis(kinematics: Kinematics, axes: Mapping[str, float]) -> tuple[str, float]:
    """Return the linear axis that moves the spindle most along its own axis, and the way out."""
    start = kinematics.machine_T_spindle(axes)
    best, along = "", 0.0
    for axis in kinematics.axes:
        if axis.rotary:
            continue
        moved = kinematics.machine_T_spindle({**axes, axis.name: axes[axis.name] + 1.0})
        share = float((moved.translation_mm - start.translation_mm) @ start.rotation[:, 2])
        if abs(share) > abs(along) + 1e-9:
            best, along = axis.name, share
    if not best:
        raise InputError(f"Expected a linear axis of {kinematics.name} along the spindle.")
    return best, math.copysign(1.0, along)


def comment(text: str) -> str:
    """Keep of a name what cannot end a comment or begin a block: a part's name is not ours."""
    return re.sub(r"[^A-Za-z0-9 ._-]", "_", text)[:60]
