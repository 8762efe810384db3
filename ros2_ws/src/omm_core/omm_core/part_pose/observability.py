"""What the images so far do not determine, in words that a person can act on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import Adjustment
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem
from omm_core.words import Words, keyed, listed

Array = NDArray[np.float64]

NAMES = ("α", "β", "γ", "x", "y", "z", "γ_s")
LARGEST_SIGMA = np.array([5e-3] * 3 + [1.0] * 3 + [5e-3])
"""An unknown that is known worse than this (rad, mm; of the targets' centre) is not determined:
a part is set up better than that by eye, and a holder turns less than that in its backlash."""
POOR_SIGMA = LARGEST_SIGMA / 5
_LINE = 0.02  # of the length
_FAR_OFF_MM = 20.0
_USUAL_BASE_MM = 40.0


def too_few(problem: Problem, options: SolveOptions) -> list[Words]:
    """Return what is missing before anything can be computed; empty where nothing is."""
    part_ids = [target.id for target in problem.part.targets]
    seen = sorted(set(problem.target_of.tolist()))
    seen_ids = [problem.target_ids[index] for index in seen]
    others = [target_id for target_id in part_ids if target_id not in seen_ids]
    if len(seen) < 3:
        return [_two_or_fewer(part_ids, seen_ids, others)]
    points = problem.points[seen, 0]
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0))
    if spread[1] < _LINE * spread[0]:
        named = ", ".join(NAMES[i] for i in np.flatnonzero(np.abs(axes[0]) > 0.5))
        return [_on_a_line(named, seen_ids, others)]
    missing = options.unknowns - 2 * len(problem)
    if missing > 0:
        return [
            keyed(
                "said.few_coordinates",
                "all: {have} coordinates were measured for {unknowns} unknowns; take at least {n}"
                " more image(s) of any target of the part.",
                have=2 * len(problem), unknowns=options.unknowns, n=-(-missing // 2),
            )
        ]  # fmt: skip
    return []


def _two_or_fewer(part_ids: list[int], seen: list[int], others: list[int]) -> Words:
    """Return what is missing where fewer than three targets were seen."""
    if len(part_ids) < 3:
        return keyed(
            "said.few_in_file",
            "all: the part file has {n} targets; at least 3 are needed.",
            n=len(part_ids),
        )
    targets = _any_of(others)
    if not seen:
        return keyed(
            "said.none_seen",
            "all: no target of the part was seen yet; at least 3 targets that do not lie on a line"
            " are needed: take an image of target {targets}.",
            targets=targets,
        )
    if len(seen) == 1:
        return keyed(
            "said.one_seen",
            "all: only target {seen} was seen; at least 3 targets that do not lie on a line are"
            " needed: take an image of target {targets}.",
            seen=seen[0], targets=targets,
        )  # fmt: skip
    return keyed(
        "said.two_seen",
        "all: only targets {seen} were seen; at least 3 targets that do not lie on a line are"
        " needed: take an image of target {targets}.",
        seen=listed(seen), targets=targets,
    )  # fmt: skip


def _on_a_line(names: str, seen: list[int], others: list[int]) -> Words:
    """Return what is missing where all targets seen lie on one line."""
    if not others:
        return keyed(
            "said.on_a_line_all",
            "the turn about the line through {targets} ({names}): all targets seen lie on it; one"
            " off the line is needed.",
            targets=listed(seen), names=names,
        )  # fmt: skip
    return keyed(
        "said.on_a_line",
        "the turn about the line through {targets} ({names}): all targets seen lie on it; one off"
        " the line is needed: take an image of target {others}.",
        targets=listed(seen), names=names, others=_any_of(others),
    )  # fmt: skip


def not_determined(
    problem: Problem, adjustment: Adjustment, covariance: Array | None, options: SolveOptions
) -> tuple[list[Words], list[Words]]:
    """Return what is not determined, and what is determined poorly.

    Parameters
    ----------
    covariance : (7, 7) array or None
        Of (ω, d_0, γ_s); None where the normal matrix is singular. Its unknowns' limits are those
        of ``LARGEST_SIGMA`` and ``POOR_SIGMA``.
    """
    sigma = _sigmas(adjustment, covariance, options)
    missing = _words(problem, adjustment, sigma, sigma > LARGEST_SIGMA, options)
    if missing:
        return missing, []
    poor = _words(problem, adjustment, sigma, sigma > POOR_SIGMA, options)
    return [], poor


def ambiguous(other: Adjustment, best: Adjustment) -> Words:
    """Return the words for a second pose that fits as well."""
    cosine = (np.trace(other.rotation @ best.rotation.T) - 1.0) / 2.0
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    apart = float(np.linalg.norm(other.d0_mm - best.d0_mm))
    holder = abs(np.degrees(other.gamma_s_rad - best.gamma_s_rad))
    return keyed(
        "said.two_poses",
        "two poses of the part fit the images equally well ({angle}° and {mm} mm apart, γ_s"
        " {holder}°): take an image of another target, or of the same targets from another"
        " direction.",
        angle=f"{angle:.2f}", mm=f"{apart:.2f}", holder=f"{holder:.2f}",
    )  # fmt: skip


def _sigmas(adjustment: Adjustment, covariance: Array | None, options: SolveOptions) -> Array:
    """Return standard deviations (7,), infinite for what takes part in a singular combination."""
    u = options.unknowns
    if covariance is not None and np.all(np.diag(covariance)[:u] > 0):
        return np.sqrt(np.diag(covariance))
    normal = adjustment.normal[:u, :u]
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    weak = vectors[:, values < 1e-10 * values[-1]]
    sigma = np.zeros(7)
    sigma[:u] = np.where(np.abs(weak).max(axis=1, initial=0.0) > 0.05, np.inf, 0.0)
    sigma[:u][np.diag(normal) <= 0.0] = np.inf
    return sigma


def _words(
    problem: Problem, adjustment: Adjustment, sigma: Array, weak: NDArray[np.bool_],
    options: SolveOptions,
) -> list[Words]:  # fmt: skip
    if not weak.any():
        return []
    names = [NAMES[i] for i in range(7) if weak[i]]
    of_gamma_s = options.model == "7d" and bool(weak[6])
    if of_gamma_s:
        which, worst = Words("γ_s"), 6
        if len(names) > 1:
            rest = ", ".join(names[:-1])
            which = keyed("said.with_it", "{first} (and with it {rest})", first="γ_s", rest=rest)
    else:
        which = Words(", ".join(names))
        worst = int(np.argmax(np.where(weak, sigma / LARGEST_SIGMA, 0.0)))
    named = _known_to(which, float(sigma[worst]), worst)
    return [_advice(problem, adjustment, sigma, named, of_gamma_s=of_gamma_s)]


def _known_to(names: Words, sigma: float, index: int) -> Words:
    """Return names with how well the worst of them is known, where it is known at all."""
    if not np.isfinite(sigma):
        return names
    if index in (3, 4, 5):
        return keyed(
            "said.known_to_mm", "{names} (known to {U} mm only, k = 2)",
            names=names, U=f"{2 * sigma:.2g}",
        )  # fmt: skip
    return keyed(
        "said.known_to_angle", "{names} (known to {U} mm/m only, k = 2)",
        names=names, U=f"{2e3 * sigma:.2g}",
    )  # fmt: skip


def _advice(
    problem: Problem, adjustment: Adjustment, sigma: Array, names: Words, *, of_gamma_s: bool
) -> Words:
    """Return which images would help: γ_s and z need targets seen from two places."""
    bases = _bases(problem)
    in_file = [target.id for target in problem.part.targets]
    by_base = sorted(bases, key=lambda t: (-bases[t][1], in_file.index(problem.target_ids[t])))
    target, base = problem.target_ids[by_base[0]], bases[by_base[0]][1]
    wanted = f"{_wanted_base(problem, adjustment, sigma):.0f}"
    once = [problem.target_ids[t] for t in by_base if bases[t][0] == 1]
    if len(once) == len(bases):
        return keyed(
            "said.one_place",
            "{names}: every target was seen from one spindle position only; take a second image of"
            " target {target} at least {mm} mm away.",
            names=names, target=target, mm=wanted,
        )  # fmt: skip
    if base < float(wanted) / 4:
        return keyed(
            "said.near_places",
            "{names}: the images of each target were taken from places at most {base} mm apart;"
            " take another image of target {target} at least {mm} mm away.",
            names=names, base=f"{base:.1f}", target=target, mm=wanted,
        )  # fmt: skip
    if once:
        return keyed(
            "said.second_image",
            "{names}: take a second image of target {targets} at least {mm} mm away.",
            names=names, targets=_any_of(once), mm=wanted,
        )  # fmt: skip
    if of_gamma_s:
        return keyed(
            "said.more_turned",
            "{names}: take more images of each target, from places farther apart or with the"
            " spindle turned about its axis.",
            names=names,
        )
    return keyed(
        "said.more_apart",
        "{names}: take more images, from spindle positions farther apart or of targets farther"
        " apart.",
        names=names,
    )


def _bases(problem: Problem) -> dict[int, tuple[int, float]]:
    """Return for each target seen: how many images, and how far apart the spindle stood, mm."""
    bases = {}
    for target in sorted(set(problem.target_of.tolist())):
        images = problem.image_of[problem.target_of == target]
        places = problem.d_cnc[images]
        apart = np.linalg.norm(places[:, None] - places[None, :], axis=2).max()
        bases[target] = (len(images), float(apart))
    return bases


def _wanted_base(problem: Problem, adjustment: Adjustment, sigma: Array) -> float:
    """Return a base of about 1/8 of the measuring distance, in whole 10 mm (40 at 300 mm)."""
    if not np.all(sigma[3:6] < _FAR_OFF_MM):
        return _USUAL_BASE_MM  # the distance is not known either
    X = problem.points[problem.target_of, 0] @ adjustment.rotation.T + adjustment.d0_mm
    spindle = problem.d_cnc[problem.image_of]
    camera = spindle + problem.R_cnc[problem.image_of] @ problem.d_calib
    distance = float(np.median(np.linalg.norm(X - camera, axis=1)))
    return float(max(10.0, np.ceil(distance / 8 / 10 - 0.25) * 10))


def _any_of(ids: list[int]) -> Words:
    return listed(ids[:4], choice=True)
