"""How long a machine takes: each move from rest to rest, within speed, acceleration and jerk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from omm_core.files.machine import AxisDynamics, Machine
from omm_core.machine.kinematics import Machine as Kinematics

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
        way = {name: abs(end[name] - start[name]) for name in self.limits}
        moving = [name for name, length in way.items() if length > 1e-9]
        if not moving:
            return 0.0
        # In shares of the way, the slowest axis limits each of the three.
        velocity, acceleration, jerk = (
            min(self.limits[name][i] / way[name] for name in moving) for i in range(3)
        )
        path = float(np.sqrt(sum(way[name] ** 2 for name in moving if name in self.linear)))
        if path > 0.0:
            velocity = min(velocity, self.feed_mm_per_s / path)
        return rest_to_rest_s(1.0, velocity, acceleration, jerk)


def rest_to_rest_s(length: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Return the shortest time for a way, from rest to rest, within three limits."""
    ramp = min(acceleration / jerk, np.sqrt(velocity / jerk))
    hold = max(0.0, velocity / (jerk * ramp) - ramp)
    if jerk * ramp * (ramp + hold) * (2 * ramp + hold) <= length:
        reached = jerk * ramp * (ramp + hold)
        return float(2 * ramp + hold + length / reached)
    # The velocity is not reached: length = j T (T + h) (2 T + h), with h = 0 or solved for it.
    ramp = min(acceleration / jerk, (length / (2.0 * jerk)) ** (1.0 / 3.0))
    hold = (-3.0 * ramp + np.sqrt(ramp**2 + 4.0 * length / (jerk * ramp))) / 2.0
    return float(2 * (2 * ramp + max(0.0, hold)))
