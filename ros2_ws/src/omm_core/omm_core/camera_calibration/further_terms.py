"""Would further lens terms have been needed? Score tests of k3, affinity and shear.

Each term t adds to the ideal coordinates: k3 (x, y) r⁶, affinity (x, 0), shear (y, 0). Its effect b
on the pixels is known at the solution, so no further adjustment is needed (as in moving.py)::

    t = s / M,  sigma = 1 / √M,  s = bᵀ W v,  M = bᵀ W b - bᵀ W A Q Aᵀ W b

What is told is also by how much the term would move the corner of the image, and by how much its
absence moves the result of the standard measurement (seven.py), the camera having been adjusted
without it: ``δc = Q Aᵀ W b t``, and what is left of ``b t`` in the measurement. That is what
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
from omm_core.camera_calibration.seven import result_sigma, standard_measurement

Array = NDArray[np.float64]

TERMS = ("k3_px6", "affinity", "shear")
# |w| above which a term is missed: one in 15 000 where the model holds.
SIGNIFICANT = 4.0
_WORTH_PX = 0.02  # at the corner: what the detector does not see either
_WORTH_SIGMAS = 1.0  # of the result: less is within what the covariance says


@dataclass(frozen=True, kw_only=True)
class FurtherTerm:
    """A term that is not in the model, as if it alone were added.

    ``result_mm`` is the largest of x, y, z by which its absence moves a standard measurement,
    ``result_sigmas`` the largest of all seven in sigma of what the calibration allows.
    """

    name: str
    value: float
    sigma: float
    corner_px: float
    result_mm: float
    result_sigmas: float

    @property
    def missed(self) -> bool:
        """Whether it is there, and large enough to matter."""
        matters = self.corner_px > _WORTH_PX or self.result_sigmas > _WORTH_SIGMAS
        return abs(self.value) > SIGNIFICANT * self.sigma and matters

    def to_json_dict(self) -> dict[str, Any]:
        """Return it as it stands under ``extra``."""
        return {
            "name": self.name, "value": self.value, "sigma": self.sigma,
            "w": self.value / self.sigma, "corner_px": self.corner_px,
            "result_mm": self.result_mm, "result_sigmas": self.result_sigmas,
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
    pixels, gain, by_camera = standard_measurement(sensor, camera)
    in_use = _effects(sensor, camera, pixels)
    widened = max(solution.sigma0, 1.0) ** 2 * solution.covariance_of("camera")
    allowed = result_sigma(sensor, camera, widened)
    found = []
    for name in TERMS:
        b = effects[name]
        weighted = np.einsum("mij,mj->mi", weights, b)
        across = _across(block, solution, weighted)
        M = float(np.sum(b * weighted)) - float(across @ solution.covariance @ across)
        if not 1e-9 * float(np.sum(b * weighted)) < M:
            continue
        value = float(np.sum(b * residual)) / M
        camera_moved = (solution.covariance @ across)[solution.slices["camera"]] * value
        moved = gain @ (value * in_use[name].ravel() - by_camera @ camera_moved)
        found.append(
            FurtherTerm(
                name=name,
                value=value,
                sigma=max(solution.sigma0, 1.0) / float(np.sqrt(M)),
                corner_px=float(np.linalg.norm(corner[name])) * abs(value),
                result_mm=float(np.abs(moved[3:6]).max()),
                result_sigmas=float(np.max(np.abs(moved) / allowed)),
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
        f" image's corner by {t.corner_px:.2f} px and a measured place by"
        f" {1000 * t.result_mm:.1f} µm; the covariance does not hold that"
        for t in terms
        if t.missed
    )
