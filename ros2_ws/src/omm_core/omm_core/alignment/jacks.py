"""How far to turn each jack so that the part comes to its nominal pose.

A jack at r (from the part's origin, machine axes) moves the part's place there along ``up``. A part
that is displaced by d and turned by the small rotation vector w stands there too high by
``up . (d + w x r)``; the correction is its negative. With ``up`` = z: ``c = -(dz + α y - β x)``.
Linear in w: from 5 mm/m the second order leaves 12.5 µm per metre, gone with the next measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.files.wishes import Jack
from omm_core.words import keyed

Array = NDArray[np.float64]
Mode = Literal["exact", "tilt", "lift"]
COVERAGE = 2.0
"""U by standard deviation; of a pose that is not normally distributed, hand over U / 2 as that."""
MODES: tuple[Mode, ...] = ("exact", "tilt", "lift")


@dataclass(frozen=True, kw_only=True)
class Correction:
    """What to turn one jack by; positive lifts."""

    name: str
    correction_mm: float
    expanded_uncertainty_mm: float
    within_travel: bool


def jack_corrections(
    jacks: Sequence[Jack],
    deviation: ArrayLike,
    covariance: ArrayLike,
    *,
    mode: Mode = "exact",
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> tuple[Correction, ...]:
    """Return the correction of each jack, in their order.

    Parameters
    ----------
    jacks : sequence of Jack
        Three or more, not in one line; here in the machine's axes, from the part's origin.
    deviation : (6,) array
        Measured minus nominal: small turns about machine X, Y, Z (rad), then x, y, z (mm) of the
        part's origin; 0 where any value will do.
    covariance : (6, 6) array
        Of ``deviation``, rad and mm.
    mode : {"exact", "tilt", "lift"}
        To the nominal pose; turned only, the part's origin stays; no jack is let down.
    up : (3,) array
        Direction in which jacks lift, machine axes.

    Raises
    ------
    InputError
        Where jacks decide no plane, or shapes or numbers are wrong.
    """
    values = np.asarray(deviation, dtype=float)
    spread = np.asarray(covariance, dtype=float)
    if values.shape != (6,) or spread.shape != (6, 6) or not np.all(np.isfinite(values)):
        raise InputError(
            f"Expected a finite deviation (6,) with covariance (6, 6), got {values.shape},"
            f" {spread.shape}."
        )
    if mode not in MODES:
        raise InputError(f"Expected one of the modes {', '.join(MODES)}, got '{mode}'.")
    jacobian = _jacobian(jacks, _unit(up), turned_only=mode == "tilt")
    corrections = jacobian @ values
    if mode == "lift":
        lowest = int(np.argmin(corrections))
        jacobian = jacobian - jacobian[lowest]
        corrections = jacobian @ values
    sigma = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", jacobian, spread, jacobian), 0.0))
    return tuple(
        Correction(
            name=jack.name,
            correction_mm=float(c),
            expanded_uncertainty_mm=float(COVERAGE * s),
            within_travel=bool(jack.travel_mm[0] <= c <= jack.travel_mm[1]),
        )
        for jack, c, s in zip(jacks, corrections, sigma, strict=True)
    )


def remarks(jacks: Sequence[Jack], corrections: Sequence[Correction]) -> tuple[str, ...]:
    """Return what the person at the jacks has to know besides the numbers."""
    told = [
        f"{c.name}: {c.correction_mm:+.3f} mm is beyond its travel of"
        f" {jack.travel_mm[0]:g} to {jack.travel_mm[1]:g} mm"
        for jack, c in zip(jacks, corrections, strict=True)
        if not c.within_travel
    ]
    if len(jacks) > 3:
        told.append(
            f"{len(jacks)} jacks: a rigid part stands on three of them; how the load is shared is"
            " not decided by these numbers"
        )
    return tuple(told)


def _jacobian(jacks: Sequence[Jack], up: Array, *, turned_only: bool) -> Array:
    """Return d(correction) / d(deviation), (jacks, 6)."""
    places = np.array([jack.xyz_mm for jack in jacks], dtype=float).reshape(-1, 3)
    flat = places - np.outer(places @ up, up)
    spread = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False) if len(jacks) > 2 else None
    if spread is None or spread[1] < 1e-6 * max(float(spread[0]), 1.0):
        raise InputError(
            keyed(
                "said.jacks_in_line",
                "Expected three or more jacks that are not in one line, got {n}.",
                n=len(jacks),
            )
        )
    moved = np.zeros_like(places) if turned_only else np.tile(up, (len(jacks), 1))
    return -np.hstack([np.cross(places, up), moved])


def _unit(up: ArrayLike) -> Array:
    vector = np.asarray(up, dtype=float)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not np.isfinite(length) or length < 1e-9:
        raise InputError(f"Expected up as a direction (3,), got {vector}.")
    return vector / length
