"""How to turn the jacks, from the newest estimate, in all modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.alignment.jacks import COVERAGE, MODES, Correction, jack_corrections
from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.files.wishes import Jack
from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.words import keyed
from omm_operator.screen.facts import EstimateFact
from omm_operator.screen.result import nominal_theta
from omm_report.language import Said, say

Array = NDArray[np.float64]
LARGEST_JACK_MM = 100_000.0
NAME_LENGTH = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """Measured minus nominal, (6,), and its covariance: turns about machine X, Y, Z, then x, y, z.

    rad and mm; zero, with zero variance, where any value will do.
    """

    values: Array
    covariance: Array


def deviation(estimate: EstimateFact, part: Part | None) -> Deviation:
    """Return how far the part is from where it is wanted.

    Where the nominal pose says "anywhere" for an angle, the measured one is taken for it: no turn
    about that axis remains. Without a nominal pose the part is wanted level: α = β = 0.
    """
    theta = np.asarray(estimate.theta, dtype=float)
    wanted = nominal_theta(part)
    if all(value is None for value in wanted):
        wanted = (0.0, 0.0, None, None, None, None)
    angles = [m if w is None else w for m, w in zip(theta[:3], wanted[:3], strict=True)]
    measured = RigidTransform.from_euler_xyz_rad(*theta[:3]).rotation
    turned = measured @ RigidTransform.from_euler_xyz_rad(*angles).rotation.T
    moved = [0.0 if w is None else m - w for m, w in zip(theta[3:6], wanted[3:], strict=True)]
    mapping = np.zeros((6, 7))
    mapping[:3, :3] = _turn_axes(float(theta[1]), float(theta[2]))
    mapping[:3, :3] *= [1.0 if w is not None else 0.0 for w in wanted[:3]]
    mapping[3:, 3:6] = np.diag([0.0 if w is None else 1.0 for w in wanted[3:]])
    return Deviation(
        values=np.array([*_rotation_vector(turned), *moved]),
        covariance=np.asarray(mapping @ _half_of_U(estimate) @ mapping.T),
    )


def _half_of_U(estimate: EstimateFact) -> Array:
    """Return the covariance with standard deviations of U / 2: twice of what follows is U again."""
    covariance = np.asarray(estimate.covariance, dtype=float)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    U = np.asarray(estimate.expanded_uncertainty, dtype=float)
    known = (sigma > 0.0) & np.isfinite(U)
    factor = np.where(known, U / np.where(known, COVERAGE * sigma, 1.0), 1.0)
    return covariance * np.outer(factor, factor)


def corrections_in_all_modes(
    estimate: EstimateFact, part: Part | None, jacks: Sequence[Jack], up: Array
) -> dict[str, tuple[Correction, ...]]:
    """Return the correction of each jack, by mode; ``jacks`` as the part file has them.

    Raises
    ------
    InputError
        Where there are fewer than three jacks, or they stand in one line.
    """
    found, standing = deviation(estimate, part), in_machine_axes(estimate, jacks)
    return {
        mode: jack_corrections(standing, found.values, found.covariance, mode=mode, up=up)
        for mode in MODES
    }


def in_machine_axes(estimate: EstimateFact, jacks: Sequence[Jack]) -> tuple[Jack, ...]:
    """Return jacks where they stand: from the part's origin, in the machine's axes."""
    rotation = estimate.machine_T_part().rotation
    return tuple(replace(jack, xyz_mm=rotation @ jack.xyz_mm) for jack in jacks)


def correction_dict(correction: Correction) -> dict[str, Any]:
    """Return what a page shows of one jack."""
    return {
        "name": correction.name,
        "mm": correction.correction_mm,
        "U": correction.expanded_uncertainty_mm,
        "within": correction.within_travel,
    }


def remarks(jacks: Sequence[Jack], corrections: Sequence[Correction]) -> list[Said]:
    """Return what the person at the jacks has to know besides the numbers."""
    told = [
        say(
            "correct.beyond",
            jack=jack.name,
            mm=f"{c.correction_mm:+.3f}",
            low=f"{jack.travel_mm[0]:g}",
            high=f"{jack.travel_mm[1]:g}",
        )
        for jack, c in zip(jacks, corrections, strict=True)
        if not c.within_travel
    ]
    return told + ([say("correct.load", count=len(jacks))] if len(jacks) > 3 else [])


def typed_jacks(entries: object) -> tuple[Jack, ...]:
    """Return jacks as somebody typed them: a list of ``{name, x_mm, y_mm}``.

    Raises
    ------
    InputError
        Where it is not such a list, or a value is not a number or out of reach.
    """
    if not isinstance(entries, list) or not 3 <= len(entries) <= 12:
        raise InputError(keyed("said.jack_count", "Expected 3 to 12 jacks."))
    jacks = tuple(_typed_jack(entry) for entry in entries)
    if len({jack.name for jack in jacks}) != len(jacks):
        raise InputError(keyed("said.jack_once", "Expected each jack's name once."))
    return jacks


def _typed_jack(entry: object) -> Jack:
    if not isinstance(entry, dict) or set(entry) != {"name", "x_mm", "y_mm"}:
        raise InputError("Expected each jack as name, x_mm, y_mm.")
    name = entry["name"]
    if not isinstance(name, str) or not name.isprintable() or not 1 <= len(name) <= NAME_LENGTH:
        raise InputError(
            keyed(
                "said.jack_name",
                "Expected a jack's name of 1 to {n} characters.",
                n=NAME_LENGTH,
            )
        )
    place = [entry["x_mm"], entry["y_mm"]]
    for value in place:
        fits = isinstance(value, int | float) and not isinstance(value, bool)
        if not fits or not abs(value) <= LARGEST_JACK_MM:
            raise InputError(
                keyed(
                    "said.jack_place",
                    "Expected a jack's place within ±{mm} mm.",
                    mm=f"{LARGEST_JACK_MM:g}",
                )
            )
    return Jack(name=name, xyz_mm=np.array([*place, 0.0], dtype=float))


def _turn_axes(beta: float, gamma: float) -> Array:
    """Return the axes about which α, β, γ turn, as columns: ω = E (dα, dβ, dγ)."""
    turned_z = rotation_from_euler_xyz_rad(0.0, 0.0, gamma)
    turned_zy = rotation_from_euler_xyz_rad(0.0, beta, gamma)
    return np.column_stack([turned_zy[:, 0], turned_z[:, 1], [0.0, 0.0, 1.0]])


def _rotation_vector(rotation: Array) -> Array:
    """Return ω of ``exp(ω×)``, for turns of less than 180°."""
    twice_sine = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine = 0.5 * float(np.linalg.norm(twice_sine))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0)))
    return twice_sine * (0.5 if sine < 1e-9 else angle / (2.0 * sine))
