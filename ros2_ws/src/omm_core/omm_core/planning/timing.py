"""How long a machine takes: each move from rest to rest, within speed, acceleration and jerk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.files.machine import AxisDynamics, Machine
from omm_core.machine.kinematics import Kinematics

Array = NDArray[np.float64]
Number = float | Array

ASSUMED = {
    False: AxisDynamics(velocity=150.0, acceleration=1000.0, jerk=10000.0),
    True: AxisDynamics(velocity=0.5, acceleration=2.0, jerk=20.0),
}
"""By whether the axis turns: mm or rad, s. Slow machines."""
ASSUMED_SETTLING_S = 0.3
ASSUMED_IMAGE_S = 0.5


@dataclass(frozen=True, kw_only=True)
class Pace:
    """How fast the axes are, and what a stop costs.

    Attributes
    ----------
    limits : mapping
        (velocity, acceleration, jerk) by axis, mm or rad, s.
    settling_s, stop_s : float
        Settling alone, and with the image.
    feed_mm_per_s : float
        The program's own limit along the path: what the slowest linear axis can do.
    assumed : tuple of str
        What machine.yaml does not tell.
    """

    limits: Mapping[str, tuple[float, float, float]]
    linear: frozenset[str]
    feed_mm_per_s: float
    settling_s: float
    stop_s: float
    assumed: tuple[str, ...] = ()

    @classmethod
    def of(cls, machine: Machine, kinematics: Kinematics, exposure_s: float = 0.0) -> Pace:
        """Return what the machine's file tells, and slow values (and their names) for the rest."""
        limits, assumed = {}, []
        for axis in kinematics.axes:
            told, slow = machine.dynamics.get(axis.name, AxisDynamics()), ASSUMED[axis.rotary]
            values = [
                (getattr(told, n), getattr(slow, n)) for n in ("velocity", "acceleration", "jerk")
            ]
            limits[axis.name] = tuple(float(a if a is not None else b) for a, b in values)
            if any(a is None for a, _ in values):
                assumed.append(f"axis {axis.name}")
        linear = [limits[axis.name][0] for axis in kinematics.axes if not axis.rotary]
        timing = machine.timing
        settling, image = timing.settling_s, timing.image_s
        assumed += [n for n, v in (("settling_s", settling), ("image_s", image)) if v is None]
        settling = ASSUMED_SETTLING_S if settling is None else settling
        image = max(ASSUMED_IMAGE_S if image is None else image, exposure_s)
        return cls(
            limits=limits,  # type: ignore[arg-type]
            linear=frozenset(axis.name for axis in kinematics.axes if not axis.rotary),
            feed_mm_per_s=min(linear, default=np.inf),
            settling_s=settling,
            stop_s=settling + image,
            assumed=tuple(assumed),
        )

    def move_s(self, start: Mapping[str, float], end: Mapping[str, float]) -> float:
        """Return how long a straight move of all axes together takes."""
        ends = (np.array([axes[name] for name in self.limits]) for axes in (start, end))
        return float(self.moves_s(*ends))

    def moves_s(self, start: Array, end: Array) -> Array:
        """Return how long straight moves take; axes (..., A) in the order of ``limits``."""
        way = np.abs(end - start)
        limits = np.array(list(self.limits.values()))  # (A, 3)
        with np.errstate(divide="ignore"):
            # In shares of the way, the slowest axis limits each of the three.
            shares = np.where(way[..., None] > 1e-9, limits / way[..., None], np.inf).min(axis=-2)
            linear = [name in self.linear for name in self.limits]
            path = np.linalg.norm(way[..., linear], axis=-1)
            velocity = np.minimum(shares[..., 0], self.feed_mm_per_s / path)
        moves = np.any(way > 1e-9, axis=-1)
        velocity, acceleration, jerk = (
            np.where(moves, limit, 1.0) for limit in (velocity, shares[..., 1], shares[..., 2])
        )
        return np.where(moves, rest_to_rest_s(1.0, velocity, acceleration, jerk), 0.0)


def rest_to_rest_s(length: Number, velocity: Number, acceleration: Number, jerk: Number) -> Array:
    """Return the shortest time for a way, from rest to rest, within three limits; elementwise."""
    ramp = np.minimum(acceleration / jerk, np.sqrt(velocity / jerk))
    hold = np.maximum(0.0, velocity / (jerk * ramp) - ramp)
    reached = jerk * ramp * (ramp + hold)
    cruising = 2 * ramp + hold + length / reached
    # The velocity is not reached: length = j T (T + h) (2 T + h), with h = 0 or solved for it.
    short = np.minimum(acceleration / jerk, np.cbrt(length / (2.0 * jerk)))
    more = (-3.0 * short + np.sqrt(short**2 + 4.0 * length / (jerk * short))) / 2.0
    braking = 2 * (2 * short + np.maximum(0.0, more))
    return np.asarray(np.where(reached * (2 * ramp + hold) <= length, cruising, braking))
