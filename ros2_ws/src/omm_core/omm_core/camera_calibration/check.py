"""Does an old calibration still hold on a new run? A test, with its power.

The run is made linear about its optimum as in ``part_pose/noise_model.py``; z, which has no part of
the pose in it, is ``z = B Δ + n`` if the camera changed by Δ since it was calibrated. n holds the
image, the machine, the targets and the calibration's own covariance. Then

- one parameter alone changed:  ``Δ_i = b_iᵀ C⁻¹ z / G_ii`` with variance ``1 / G_ii``,
  G = Bᵀ C⁻¹ B;
- anything changed: ``hᵀ G⁺ h``, h = Bᵀ C⁻¹ z, over the directions in which a change as large as a
  knock makes (:func:`plausible_changes`) would show at all: chi-square.

What a change would have had to be, to be seen in 19 of 20 runs, is ``(limit + 1.645) / √G_ii``
(Baarda 1968). The machine's noise is estimated with the camera left free, so that a changed camera
does not pass for a bad machine, and every machine there may be counts with its probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.camera_calibration.check_evidence import Evidence
from omm_core.errors import MeasurementError
from omm_core.files.part import Part
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.lens import BrownPhotogrammetric, PlumbBob
from omm_core.part_pose import Observation, SolveOptions, build_problem
from omm_core.part_pose.blunders import BlunderSearch, search_blunders
from omm_core.part_pose.machine_noise import MachineNoise, summarise
from omm_core.part_pose.noise_model import calibration_effect, noise_model

Array = NDArray[np.float64]

# Of holding where it holds, for the test of everything and for those of one parameter together.
_DOUBT = 0.001
_ALIKE = 6.6  # of chi-square: changes that explain as much as the best one


@dataclass(frozen=True, kw_only=True)
class ParameterCheck:
    """One parameter, as if it alone had changed.

    ``detectable`` would have been seen in 19 of 20 runs; infinite where the run does not show it.
    ``moves_part_mm`` is by how much a target would be misplaced by a change of that size, or by
    the ``plausible`` one where none is seen.
    """

    name: str
    change: float
    sigma: float
    detectable: float
    plausible: float
    moves_part_mm: float
    p_value: float

    @property
    def seen(self) -> bool:
        """Whether the run says anything of it."""
        return bool(np.isfinite(self.detectable))


@dataclass(frozen=True, kw_only=True)
class CalibrationCheck:
    """Whether a calibration holds, and what would have been seen.

    ``explained_by`` names the parameters of which one alone explains best what was found;
    ``machine`` is the noise that was found with the camera left free.
    """

    name: str
    holds: bool
    p_value: float
    chi2: float
    degrees_of_freedom: int
    parameters: tuple[ParameterCheck, ...]
    explained_by: tuple[str, ...]
    images: int
    observations: int
    machine: MachineNoise | None
    findings: tuple[str, ...]

    def to_json_dict(self) -> dict[str, Any]:
        """Return ``calibrate --check --json``; null is what the run does not show."""
        return {
            "holds": self.holds,
            "p_value": self.p_value,
            "chi2": self.chi2,
            "degrees_of_freedom": self.degrees_of_freedom,
            "images": self.images,
            "observations": self.observations,
            "explained_by": list(self.explained_by),
            "parameters": [
                {
                    "name": p.name,
                    **{
                        key: getattr(p, key) if p.seen else None
                        for key in ("change", "sigma", "detectable", "p_value")
                    },
                    "plausible": p.plausible,
                    "moves_part_mm": p.moves_part_mm if np.isfinite(p.moves_part_mm) else None,
                }
                for p in self.parameters
            ],
            "findings": list(self.findings),
        }


def plausible_changes(calibration: CameraCalibration) -> dict[str, float]:
    """Return by how much a knock, a refocus or the heat of a day may change each parameter.

    1 % of the focal length and, for the principal point, of the image's width; 2 px at the corner
    by each distortion term; 1 mm and 2 mrad for the camera in its holder.
    """
    lens = calibration.lens
    corner = float(np.hypot(lens.width_px, lens.height_px)) / 2
    place = dict.fromkeys(("x_mm", "y_mm", "z_mm"), 1.0)
    place |= dict.fromkeys(("alpha_rad", "beta_rad", "gamma_rad"), 2e-3)
    point = 0.01 * lens.width_px
    if isinstance(lens, BrownPhotogrammetric):
        return {
            "focal_length_mm": 0.01 * lens.focal_length_mm, "cl0_px": point, "rw0_px": point,
            "k1_px2": 2 / corner**3, "k2_px4": 2 / corner**5,
            "p1_px": 1 / corner**2, "p2_px": 1 / corner**2, **place,
        }  # fmt: skip
    if not isinstance(lens, PlumbBob):
        raise TypeError(f"Expected a known lens, got {type(lens).__name__}.")
    tangent = corner / lens.fx_px
    one = 2 / lens.fx_px
    return {
        "fx_px": 0.01 * lens.fx_px, "fy_px": 0.01 * lens.fy_px, "cx_px": point, "cy_px": point,
        "k1": one / tangent**3, "k2": one / tangent**5, "p1": one / tangent**2,
        "p2": one / tangent**2, "k3": one / tangent**7, **place,
    }  # fmt: skip


def check_calibration(
    observations: Sequence[Observation],
    part: Part,
    calibration: CameraCalibration,
    options: SolveOptions | None = None,
) -> CalibrationCheck:
    """Test a calibration against what a run shows.

    Parameters
    ----------
    observations : sequence of Observation
        Of one clamping.
    part, calibration
        As the run is solved with; the calibration's covariance counts as its uncertainty.
    options : SolveOptions, optional
        The machine, where it is declared; else its noise is estimated.

    Raises
    ------
    MeasurementError
        Where the run does not determine the part's pose, whatever the camera.
    """
    options = options or SolveOptions()
    steps = plausible_changes(calibration)
    free = _loosened(calibration, steps)
    found = search_blunders(build_problem(observations, part, free), options)
    if found.posterior is None or found.contradictory:
        return _lost(found, calibration, steps)
    if found.posterior.model.redundancy < 1:
        raise MeasurementError(
            "The run does not check anything: it has as many measured coordinates as unknowns."
            " Take more images."
        )
    problem = replace(found.fit.problem, calibration=calibration)
    model = noise_model(problem, found.posterior.model.adjustment, options)
    effect = model.split @ calibration_effect(problem, model.adjustment, model.whitening, steps)
    return _judged(Evidence.of(model, found.posterior, effect), found, calibration, steps)


def _loosened(calibration: CameraCalibration, steps: dict[str, float]) -> CameraCalibration:
    """Return the calibration as known before anyone looks whether something changed."""
    names = tuple(steps)
    covariance = np.diag(np.square(list(steps.values())))
    at = [names.index(name) for name in calibration.parameters]
    if at:
        covariance[np.ix_(at, at)] += calibration.covariance
    return replace(calibration, parameters=names, covariance=covariance)


def _judged(
    evidence: Evidence,
    found: BlunderSearch,
    calibration: CameraCalibration,
    steps: dict[str, float],
) -> CalibrationCheck:
    p_value, squares, freedom = evidence.everything()
    doubt = _DOUBT / len(steps)
    parameters = []
    for i, (name, step) in enumerate(steps.items()):
        change, sigma, p_alone, detectable = evidence.alone(i, doubt)
        parameters.append(
            ParameterCheck(
                name=name,
                change=change * step,
                sigma=sigma * step,
                detectable=detectable * step,
                plausible=step,
                moves_part_mm=evidence.shift_mm[i] * (detectable if detectable < np.inf else 1.0),
                p_value=p_alone,
            )
        )
    holds = p_value >= _DOUBT and all(p.p_value >= doubt for p in parameters)
    assert found.posterior is not None
    return CalibrationCheck(
        name=calibration.name,
        holds=holds,
        p_value=p_value,
        chi2=squares,
        degrees_of_freedom=freedom,
        parameters=tuple(parameters),
        explained_by=() if holds else _explanations(parameters),
        images=len(np.unique(found.fit.problem.image_of)),
        observations=int((~found.dropped).sum()),
        machine=summarise(found.posterior.grid, found.posterior.weight),
        findings=found.findings,
    )


def _explanations(parameters: list[ParameterCheck]) -> tuple[str, ...]:
    """Return what may have changed: the parameters that explain as much as the best one."""
    explained = {p.name: (p.change / p.sigma) ** 2 for p in parameters if p.seen}
    best = max(explained.values(), default=0.0)
    return tuple(
        name for name, value in sorted(explained.items(), key=lambda e: -e[1])
        if value > max(best - _ALIKE, best / 2)
    )  # fmt: skip


def _lost(
    found: BlunderSearch, calibration: CameraCalibration, steps: dict[str, float]
) -> CalibrationCheck:
    """Return the verdict where no noise and no plausible change explains what was seen."""
    if found.posterior is None and not found.fit.unseen:
        raise MeasurementError(
            "The run does not tell the part's pose: " + " ".join(found.fit.missing)
        )
    words = (
        "the residuals are larger than any machine and any plausible change of the camera explain:"
        " another camera or lens, other images, a wrong part file, or targets that moved"
    )
    nothing = {key: np.nan for key in ("change", "sigma", "moves_part_mm")}
    return CalibrationCheck(
        name=calibration.name,
        holds=False,
        p_value=0.0,
        chi2=found.fit.cost if np.isfinite(found.fit.cost) else 0.0,
        degrees_of_freedom=found.fit.degrees_of_freedom,
        parameters=tuple(
            ParameterCheck(name=name, detectable=np.inf, plausible=step, p_value=1.0, **nothing)
            for name, step in steps.items()
        ),
        explained_by=(),
        images=len(found.fit.problem.stamps_ns),
        observations=int((~found.dropped).sum()),
        machine=None,
        findings=(*found.findings, words),
    )
