"""What is observed: targets in photographs, and bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.targets.detected import DetectedTarget
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]

CODED, PLAIN = "coded", "plain"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """A target in a photograph.

    Attributes
    ----------
    photo, point : int
        Numbers; a coded target's own, below zero for plain ones.
    center_px, covariance_px2 : (2,), (2, 2) arrays
        Centre of the ellipse and what the detector thinks of it.
    kind : str
        ``coded`` or ``plain``: whose noise it shares.
    spread_px2 : (2, 2) array or None
        Matrix S of the ellipse dᵀ S⁻¹ d = 1.
    """

    photo: int
    point: int
    center_px: Array
    covariance_px2: Array
    kind: str = CODED
    spread_px2: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A scale bar between two points."""

    ends: tuple[int, int]
    length_mm: float
    sigma_mm: float


def sighting_of_target(photo: int, target: DetectedTarget) -> Sighting:
    """Return a coded target that was read."""
    c, s = np.cos(target.angle_rad), np.sin(target.angle_rad)
    turn = np.array([[c, -s], [s, c]])
    spread = turn @ np.diag((np.array(target.axes_px) / 2.0) ** 2) @ turn.T
    return Sighting(
        photo=photo, point=target.id, center_px=target.center_px,
        covariance_px2=target.covariance_px2, spread_px2=spread,
    )  # fmt: skip


def sighting_of_dot(photo: int, point: int, dot: PlainDot, kind: str = PLAIN) -> Sighting:
    """Return a plain dot, once it is known which point it is."""
    return Sighting(
        photo=photo, point=point, center_px=dot.center_px, covariance_px2=dot.covariance_px2,
        kind=kind, spread_px2=dot.spread_px2,
    )  # fmt: skip
