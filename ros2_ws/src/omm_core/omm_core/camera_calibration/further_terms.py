"""Would further lens terms have been needed? Score tests of k3, affinity and shear.

Each term t adds to the ideal coordinates: k3 (x, y) r⁶, affinity (x, 0), shear (y, 0). Its effect b
on the pixels is known at the solution, so no further adjustment is needed (as in moving.py)::

    t = s / M,  sigma = 1 / √M,  s = bᵀ W v,  M = bᵀ W b - bᵀ W A Q Aᵀ W b

What is told is also by how much the term would move the corner of the image, since that is what
counts: a term may be significant and not worth having.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Solution
from omm_core.adjustment.normal_equations import group_of
from omm_core.camera_calibration.model import Sensor

Array = NDArray[np.float64]

TERMS = ("k3_px6", "affinity", "shear")
# |w| above which a term is missed: one in 15 000 where the model holds.
SIGNIFICANT = 4.0
_WORTH_PX = 0.02  # at the corner: what the detector does not see either


@dataclass(frozen=True, kw_only=True)
class FurtherTerm:
    """A term that is not in the model, as if it alone were added."""

    name: str
    value: float
    sigma: float
    corner_px: float

    @property
    def missed(self) -> bool:
        """Whether it is there, and large enough to matter."""
        return abs(self.value) > SIGNIFICANT * self.sigma and self.corner_px > _WORTH_PX

    def to_json_dict(self) -> dict[str, Any]:
        """Return it as it stands under ``extra``."""
        return {
            "name": self.name, "value": self.value, "sigma": self.sigma,
            "w": self.value / self.sigma, "corner_px": self.corner_px,
        }  # fmt: skip


def further_terms(
    sensor: Sensor, camera: Array, block: Block, solution: Solution
) -> tuple[FurtherTerm, ...]:
    """Return the tests of all terms.

    Parameters
    ----------
    block : Block
        The pixels (m, 2), as adjusted.
    solution : Solution
        sigma0 above 1 widens the sigma of the terms.
    """
    weights = block.weights()
    residual = np.einsum("mij,mj->mi", weights, solution.residuals["pixels"])
    effects = _effects(sensor, camera, block.observed)
    size = np.array([sensor.width_px, sensor.height_px])
    corner = _effects(sensor, camera, (size - 1.0)[None])
    found = []
    for name in TERMS:
        b = effects[name]
        weighted = np.einsum("mij,mj->mi", weights, b)
        across = _across(block, solution, weighted)
        M = float(np.sum(b * weighted)) - float(across @ solution.covariance @ across)
        if not 1e-9 * float(np.sum(b * weighted)) < M:
            continue
        value = float(np.sum(b * residual)) / M
        found.append(
            FurtherTerm(
                name=name,
                value=value,
                sigma=max(solution.sigma0, 1.0) / float(np.sqrt(M)),
                corner_px=float(np.linalg.norm(corner[name])) * abs(value),
            )
        )
    return tuple(found)


def _effects(sensor: Sensor, camera: Array, pixels: Array) -> dict[str, Array]:
    """Return d(pixel)/d(term) by term, (m, 2): what is added to the ideal moves the measured."""
    lens = sensor.lens(camera)
    by_normalised = lens.pixels_from_normalised(lens.normalised_from_pixels(pixels))[1]
    x, y = (pixels - lens.principal_point_px).T
    r6 = (x * x + y * y) ** 3
    nothing = np.zeros_like(x)
    added = {"k3_px6": (x * r6, y * r6), "affinity": (x, nothing), "shear": (y, nothing)}
    return {
        name: -np.einsum("mij,mj->mi", by_normalised, np.stack(values, axis=1))
        / lens.principal_distance_px
        for name, values in added.items()
    }


def _across(block: Block, solution: Solution, weighted: Array) -> Array:
    """Return (W b)ᵀ A summed over all observations, (U,)."""
    across = np.zeros(len(solution.covariance))
    for reference, derivative in solution.derivatives["pixels"].items():
        k = derivative.shape[2]
        start = solution.slices[group_of(reference)].start
        columns = start + block.index[reference][:, None] * k + np.arange(k)
        np.add.at(across, columns, np.einsum("mi,mik->mk", weighted, derivative))
    return across


def words_of_missed(terms: tuple[FurtherTerm, ...]) -> tuple[str, ...]:
    """Return a finding for each term that is missed."""
    return tuple(
        f"the lens model misses {t.name}: {t.value:.3g} (sigma {t.sigma:.2g}), which moves the"
        f" image's corner by {t.corner_px:.2f} px; the covariance does not hold that"
        for t in terms
        if t.missed
    )
