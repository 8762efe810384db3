"""What became of every image, and of every target found in it, once they are solved."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from omm_core.files.part import Part
from omm_core.part_pose import Solution
from omm_core.session.images import JudgedImage, SeenTarget
from omm_core.session.result import ImageOutcome, ObservationOutcome
from omm_core.words import Words, keyed

_NOT_IN_PART = keyed("said.not_in_part", "not a target of the part")
_MORE_THAN_ONCE = keyed("said.more_than_once", "the number was found more than once in this image")
_NOTHING_SOLVED = keyed("said.nothing_solved", "nothing could be solved yet")


def observation_outcomes(
    images: Sequence[JudgedImage], part: Part, solution: Solution
) -> tuple[ObservationOutcome, ...]:
    """Return what became of every target that was found, by image and number."""
    solved = {(o.stamp_ns, o.target_id): i for i, o in enumerate(solution.observations)}
    position_among_used = np.cumsum(solution.used) - 1
    outcomes = []
    for image in images:
        for seen in image.seen:
            index = None
            if image.refused is None:
                index = solved.get((image.stamp_ns, seen.target_id))
            used = index is not None and bool(solution.used[index])
            reason = None if used else _why_not(image, seen, part, index, solution)
            residual = (np.nan, np.nan) if index is None else solution.residuals_px[index]
            k = int(position_among_used[index]) if used and index is not None else None
            outcomes.append(
                ObservationOutcome(
                    stamp_ns=image.stamp_ns,
                    target_id=seen.target_id,
                    center_px=seen.center_px,
                    residual_px=(float(residual[0]), float(residual[1])),
                    used=used,
                    reason=reason,
                    **_statistics(solution, k),
                )
            )
    return tuple(outcomes)


def _statistics(solution: Solution, k: int | None) -> dict[str, float]:
    """Return the statistics of the k-th observation used; none where there are none."""
    if k is None or solution.statistics is None:
        return {}
    s = solution.statistics
    return {
        "redundancy": float(s.redundancy[k]),
        "w_test": float(s.w_test[k]),
        "smallest_detectable_px": float(s.smallest_detectable_px[k]),
        "external_sigma": float(s.external_sigma[k]),
    }


def _why_not(
    image: JudgedImage, seen: SeenTarget, part: Part, index: int | None, solution: Solution
) -> Words:
    if part.target(seen.target_id) is None:
        return _NOT_IN_PART
    if image.refused is not None:
        return image.refused
    if index is None:
        return _MORE_THAN_ONCE
    return solution.reasons[index] or _NOTHING_SOLVED


def image_outcomes(
    images: Sequence[JudgedImage], observations: Sequence[ObservationOutcome]
) -> tuple[ImageOutcome, ...]:
    """Return what became of every image.

    Sound images count as used even while there are too few of them to solve.
    """
    left_out = {o.stamp_ns: o.reason for o in observations if not o.used}
    with_used = {o.stamp_ns for o in observations if o.used}
    outcomes = []
    for image in images:
        used = image.refused is None and (image.stamp_ns in with_used or not with_used)
        reason = None if used else image.refused or left_out.get(image.stamp_ns)
        outcomes.append(
            ImageOutcome(
                stamp_ns=image.stamp_ns, used=used, reason=reason, pending=image.pose.pending
            )
        )
    return tuple(outcomes)


def images_per_target(
    images: Sequence[JudgedImage],
    observations: Sequence[ObservationOutcome],
    part: Part,
    determined: bool,
) -> dict[int, int]:
    """Return in how many used images each target of the part was seen.

    Until there is a solution, what was seen in sound images counts as used.
    """
    if determined:
        ids = [o.target_id for o in observations if o.used]
    else:
        sound = (image for image in images if image.refused is None)
        ids = [seen.target_id for image in sound for seen in image.usable(part)]
    counts = Counter(ids)
    return {target.id: counts[target.id] for target in part.targets}
