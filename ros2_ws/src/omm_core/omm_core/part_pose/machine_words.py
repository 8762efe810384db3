"""Say how exact the machine was, whose error it is, and what would help."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.machine_noise import Level, MachineNoise
from omm_core.part_pose.posterior import CALIBRATION, GEOMETRY, IMAGE, STOPS, TARGETS
from omm_core.part_pose.problem import Problem
from omm_core.words import Words, in_a_row, keyed, listed

Array = NDArray[np.float64]

_SYMBOLS = ("α", "β", "γ", "x", "y", "z", "γ_s")
_MUCH = 0.5  # of the variance
_HELP = {
    IMAGE: keyed(
        "said.help_image", "the centres in the images: measure from nearer, or take more images"
    ),
    STOPS: keyed("said.help_stops", "how well the stops repeat: take more images of each target"),
    GEOMETRY: keyed(
        "said.help_geometry",
        "the machine's geometry: declare it in machine.yaml, or measure more targets",
    ),
    TARGETS: keyed(
        "said.help_targets", "the targets' coordinates: measure more targets, or know them better"
    ),
    CALIBRATION: keyed("said.help_calibration", "the calibration: calibrate the camera better"),
}


def remarks(
    problem: Problem, noise: MachineNoise, shares: dict[str, Array], unknowns: int
) -> tuple[Words, ...]:
    """Return what a person should know of a result."""
    told = [noise_words(noise)]
    exact = [i for i in problem.part.taken_as_exact() if i in problem.target_ids]
    if exact:
        told.append(_taken_as_exact(exact, everything=len(exact) == len(problem.target_ids)))
    if "geometry_sigma_mm" in noise.estimated:
        told.append(
            keyed(
                "said.own_coordinates",
                "the pose is given in the machine's own coordinates; for the absolute pose, errors"
                " of the machine's geometry that are longer than the part remain unseen (declare"
                " the geometry in machine.yaml)",
            )
        )
    return (*told, *_most_helpful(shares, unknowns))


def _taken_as_exact(ids: list[int], *, everything: bool) -> Words:
    if everything:
        return keyed(
            "said.all_exact",
            "the coordinates of all targets count as exact: the part file gives no sigma_xyz_mm"
            " for them; if they err, U is too small",
        )
    return keyed(
        "said.some_exact",
        "the coordinates of targets {targets} count as exact: the part file gives no sigma_xyz_mm"
        " for them; if they err, U is too small",
        targets=listed(ids),
    )


def noise_words(noise: MachineNoise) -> Words:
    """Return "the machine's errors: stops 3.5 µm (2 to 6), geometry 2 µm (0 to 5)"."""
    stops = _declared(_um(noise.stop_sigma_mm), "stop_sigma_mm" not in noise.estimated)
    geometry = _declared(_um(noise.geometry_sigma_mm), "geometry_sigma_mm" not in noise.estimated)
    if noise.image_scale > 1.0:
        return keyed(
            "said.machine_and_centres",
            "the machine's errors: stops {stops}, geometry {geometry}, centres {times} times worse"
            " than the detector says",
            stops=stops, geometry=geometry, times=f"{noise.image_scale:g}",
        )  # fmt: skip
    return keyed(
        "said.machine_errors",
        "the machine's errors: stops {stops}, geometry {geometry}",
        stops=stops, geometry=geometry,
    )  # fmt: skip


def _declared(size: Words, declared: bool) -> Words:
    return keyed("said.declared", "{size} (declared)", size=size) if declared else size


def _um(level: Level) -> Words:
    median, low, high = (f"{1e3 * v:.3g}" for v in (level.median, level.low, level.high))
    if not level.high > level.low:
        return Words(f"{median} µm")
    return keyed("said.range", "{um} µm ({low} to {high})", um=median, low=low, high=high)


def _most_helpful(shares: dict[str, Array], unknowns: int) -> list[Words]:
    """Return what a source contributes most to, and what to do about it."""
    told = []
    for source, share in shares.items():
        much = [i for i in range(unknowns) if share[i] > _MUCH]
        if much:
            of = [
                keyed("said.share", "{n} % of {what}", n=f"{100 * share[i]:.0f}", what=_SYMBOLS[i])
                for i in much
            ]
            told.append(
                keyed(
                    "said.comes_from",
                    "{much} comes from {source}",
                    much=in_a_row(of),
                    source=_HELP[source],
                )
            )
    return told


def disagreement(ratio: float) -> Words:
    """Return words for residuals that the declared machine does not explain."""
    return keyed(
        "said.less_exact",
        "the machine is not as exact as its file declares: the residuals are {times} times larger;"
        " U is enlarged by that",
        times=f"{ratio:.1f}",
    )


def better_than_declared(ratio: float) -> Words:
    """Return words for residuals that are far smaller than the declared machine's."""
    return keyed(
        "said.more_exact",
        "the machine is more exact than its file declares: the residuals are {times} times smaller",
        times=f"{ratio:.1f}",
    )
