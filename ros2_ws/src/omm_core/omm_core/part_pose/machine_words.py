"""Say how exact the machine was, whose error it is, and what would help."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.machine_noise import Level, MachineNoise
from omm_core.part_pose.posterior import CALIBRATION, GEOMETRY, IMAGE, STOPS, TARGETS
from omm_core.part_pose.problem import Problem

Array = NDArray[np.float64]

_SYMBOLS = ("α", "β", "γ", "x", "y", "z", "γ_s")
_MUCH = 0.5  # of the variance
_HELP = {
    IMAGE: "the centres in the images: measure from nearer, or take more images",
    STOPS: "how well the stops repeat: take more images of each target",
    GEOMETRY: "the machine's geometry: declare it in machine.yaml, or measure more targets",
    TARGETS: "the targets' coordinates: measure more targets, or know them better",
    CALIBRATION: "the calibration: calibrate the camera better",
}


def remarks(
    problem: Problem, noise: MachineNoise, shares: dict[str, Array], unknowns: int
) -> tuple[str, ...]:
    """Return what a person should know of a result."""
    told = [noise_words(noise)]
    exact = [i for i in problem.part.taken_as_exact() if i in problem.target_ids]
    if exact:
        named = (
            "all targets" if len(exact) == len(problem.target_ids) else f"targets {_list(exact)}"
        )
        told.append(
            f"the coordinates of {named} count as exact: the part file tells no sigma_xyz_mm of"
            " them; if they err, U is too small"
        )
    if "geometry_sigma_mm" in noise.estimated:
        told.append(
            "the pose is told in the machine's own coordinates; of the absolute one, errors of the"
            " machine's geometry that are longer than the part are not seen (declare the geometry"
            " in machine.yaml)"
        )
    return (*told, *_most_helpful(shares, unknowns))


def noise_words(noise: MachineNoise) -> str:
    """Return "the machine: stops 3.5 µm (2 to 6), geometry 2 µm (0 to 5)"."""
    words = [
        f"{what} {_um(level)}" + ("" if name in noise.estimated else " (declared)")
        for what, name, level in (
            ("stops", "stop_sigma_mm", noise.stop_sigma_mm),
            ("geometry", "geometry_sigma_mm", noise.geometry_sigma_mm),
        )
    ]
    if noise.image_scale > 1.0:
        words.append(f"centres {noise.image_scale:g} times worse than the detector says")
    return f"the machine's errors: {', '.join(words)}"


def _um(level: Level) -> str:
    median, low, high = (1e3 * v for v in (level.median, level.low, level.high))
    return f"{median:.3g} µm" + (f" ({low:.3g} to {high:.3g})" if high > low else "")


def _most_helpful(shares: dict[str, Array], unknowns: int) -> list[str]:
    """Return what a source contributes most to, and what to do about it."""
    told = []
    for source, share in shares.items():
        much = [i for i in range(unknowns) if share[i] > _MUCH]
        if much:
            of = ", ".join(f"{100 * share[i]:.0f} % of {_SYMBOLS[i]}" for i in much)
            told.append(f"{of} comes from {_HELP[source]}")
    return told


def disagreement(ratio: float) -> str:
    """Return words for residuals that the declared machine does not explain."""
    return (
        f"the machine is not as exact as its file declares: the residuals are {ratio:.1f} times"
        " larger; U is enlarged by that"
    )


def better_than_declared(ratio: float) -> str:
    """Return words for residuals that are far smaller than the declared machine's."""
    return (
        f"the machine is more exact than its file declares: the residuals are {ratio:.1f} times"
        " smaller"
    )


def _list(ids: list[int]) -> str:
    words = [str(i) for i in ids]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
