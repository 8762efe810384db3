"""What the images so far do not determine, in words that a person can act on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import Adjustment
from omm_core.part_pose.problem import Problem, SolveOptions

Array = NDArray[np.float64]

NAMES = ("α", "β", "γ", "x", "y", "z", "γ_s")
LARGEST_SIGMA = np.array([5e-3] * 3 + [1.0] * 3 + [5e-3])
"""An unknown that is known worse than this (rad, mm; of the targets' centre) is not determined:
a part is set up better than that by eye, and a holder turns less than that in its backlash."""
POOR_SIGMA = LARGEST_SIGMA / 5
_ON_A_LINE = 0.02  # of the length
_FAR_OFF_MM = 20.0
_USUAL_BASE_MM = 40.0


def too_few(problem: Problem, options: SolveOptions) -> list[str]:
    """Return what is missing before anything can be computed; empty where nothing is."""
    part_ids = [target.id for target in problem.part.targets]
    seen = sorted(set(problem.target_of.tolist()))
    seen_ids = [problem.target_ids[index] for index in seen]
    others = [target_id for target_id in part_ids if target_id not in seen_ids]
    if len(seen) < 3:
        have = f"only {_targets(seen_ids)} seen" if seen else "no target of the part was seen yet"
        if len(part_ids) < 3:
            return [f"all: the part file has {len(part_ids)} targets; at least 3 are needed."]
        return [
            f"all: {have}; at least 3 targets that do not lie on a line are needed: take an"
            f" image of {_any_of(others)}."
        ]
    points = problem.points[seen, 0]
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0))
    if spread[1] < _ON_A_LINE * spread[0]:
        named = ", ".join(NAMES[i] for i in np.flatnonzero(np.abs(axes[0]) > 0.5))
        off = f": take an image of {_any_of(others)}" if others else ""
        return [
            f"the turn about the line through {_list(seen_ids)} ({named}): all targets seen lie"
            f" on it; one off the line is needed{off}."
        ]
    missing = options.unknowns - 2 * len(problem)
    if missing > 0:
        return [
            f"all: {2 * len(problem)} coordinates were measured for {options.unknowns} unknowns;"
            f" take at least {-(-missing // 2)} more image(s) of any target of the part."
        ]
    return []


def not_determined(
    problem: Problem, adjustment: Adjustment, covariance: Array | None, options: SolveOptions
) -> tuple[list[str], list[str]]:
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


def ambiguous(other: Adjustment, best: Adjustment) -> str:
    """Return the words for a second pose that fits as well."""
    cosine = (np.trace(other.rotation @ best.rotation.T) - 1.0) / 2.0
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    apart = float(np.linalg.norm(other.d0_mm - best.d0_mm))
    holder = abs(np.degrees(other.gamma_s_rad - best.gamma_s_rad))
    return (
        f"two poses of the part fit the images equally well ({angle:.2f}° and {apart:.2f} mm apart,"
        f" γ_s {holder:.2f}°): take an image of another target, or of the same targets from"
        " another direction."
    )


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
) -> list[str]:  # fmt: skip
    if not weak.any():
        return []
    names = [NAMES[i] for i in range(7) if weak[i]]
    of_gamma_s = options.model == "7d" and bool(weak[6])
    advice = _advice(problem, adjustment, sigma, of_gamma_s=of_gamma_s)
    if of_gamma_s:
        rest = f" (and with it {', '.join(names[:-1])})" if len(names) > 1 else ""
        return [f"γ_s{rest}{_known_to(sigma[6])}: {advice}."]
    worst = int(np.argmax(np.where(weak, sigma / LARGEST_SIGMA, 0.0)))
    return [f"{', '.join(names)}{_known_to(sigma[worst], worst)}: {advice}."]


def _known_to(sigma: float, index: int = 6) -> str:
    if not np.isfinite(sigma):
        return ""
    if index in (3, 4, 5):
        return f" (known to {2 * sigma:.2g} mm only, k = 2)"
    return f" (known to {2e3 * sigma:.2g} mm/m only, k = 2)"


def _advice(problem: Problem, adjustment: Adjustment, sigma: Array, *, of_gamma_s: bool) -> str:
    """Return which images would help: γ_s and z need targets seen from two places."""
    bases = _bases(problem)
    in_file = [target.id for target in problem.part.targets]
    by_base = sorted(bases, key=lambda t: (-bases[t][1], in_file.index(problem.target_ids[t])))
    target_id, base = problem.target_ids[by_base[0]], bases[by_base[0]][1]
    wanted = _wanted_base(problem, adjustment, sigma)
    once = [problem.target_ids[t] for t in by_base if bases[t][0] == 1]
    if len(once) == len(bases):
        return (
            "every target was seen from one spindle position only; take a second image of target"
            f" {target_id} at least {wanted:.0f} mm away"
        )
    if base < wanted / 4:
        return (
            f"the images of each target were taken from places at most {base:.1f} mm apart; take"
            f" another image of target {target_id} at least {wanted:.0f} mm away"
        )
    if once:
        return f"take a second image of {_any_of(once)} at least {wanted:.0f} mm away"
    if of_gamma_s:
        return (
            "take more images of each target, from places farther apart or with the spindle turned"
            " about its axis"
        )
    return "take more images, from spindle positions farther apart or of targets farther apart"


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


def _list(ids: list[int]) -> str:
    words = [str(i) for i in ids]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _targets(ids: list[int]) -> str:
    return f"target {ids[0]} was" if len(ids) == 1 else f"targets {_list(ids)} were"


def _any_of(ids: list[int]) -> str:
    if not ids:
        return "any target"
    words = [str(i) for i in ids[:4]]
    return "target " + (
        " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
    )
