"""Name what is wrong with observations: what would explain where they were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import Adjustment
from omm_core.part_pose.fit import PoseFit
from omm_core.part_pose.kernels import predict_all
from omm_core.part_pose.problem import Indices, Problem
from omm_core.words import Words, image_number, keyed, verbatim

Array = NDArray[np.float64]


_SAME_PX = 3.0
_SAME_MM = 0.1
_SAME_RAD = 1e-4


def describe(
    problem: Problem,
    members: NDArray[np.bool_],
    kind: Literal["observation", "image", "target"],
    without: PoseFit,
) -> Words:
    """Return words for wrong observations, given the fit without them."""
    assert without.best is not None
    indices = np.flatnonzero(members)
    if kind == "target":
        return _bumped(problem, indices, without.best)
    other = _pose_of_another_image(problem, indices, without.best)
    images = {int(problem.image_of[index]) for index in indices}
    image = _number(problem, problem.stamps_ns[images.pop()])
    off = f"{float(np.max(_off_px(problem, indices, without.best))):.2f}"
    if other is not None:
        return keyed(
            "said.pose_of_other",
            "the spindle pose given for image {image} is not where it was taken: the image fits the"
            " pose of image {other}",
            image=image, other=_number(problem, other),
        )  # fmt: skip
    shared = _shares_pose(problem, int(problem.image_of[indices[0]]))
    if shared is not None:
        return keyed(
            "said.pose_shared",
            "the spindle pose given for image {image} is not where it was taken: it is that of"
            " image {other}",
            image=image, other=_number(problem, shared),
        )  # fmt: skip
    if kind == "image":
        return keyed(
            "said.pose_wrong",
            "all targets in image {image} are up to {px} px off: its spindle pose is wrong",
            image=image, px=off,
        )  # fmt: skip
    target_id = problem.target_ids[problem.target_of[indices[0]]]
    read_as = _misread(problem, int(indices[0]), without.best)
    if read_as is not None:
        return keyed(
            "said.misread",
            "target {target} was read as {other} in image {image}",
            target=read_as, other=target_id, image=image,
        )  # fmt: skip
    alone = np.count_nonzero(problem.image_of == problem.image_of[indices[0]]) == 1
    return _off(target_id, image, off, alone=alone)


def _number(problem: Problem, stamp_ns: int) -> Words:
    return image_number(stamp_ns, problem.run_ns)


def _off(target_id: int, image: Words, off: str, *, alone: bool) -> Words:
    """Return words for a centre that is off: alone in its image, it may be the pose as well."""
    if alone:
        return keyed(
            "said.centre_or_pose_wrong",
            "target {target} in image {image} is {px} px off: its centre or the image's spindle"
            " pose is wrong (a reflection or dirt on the dot?)",
            target=target_id, image=image, px=off,
        )  # fmt: skip
    return keyed(
        "said.centre_wrong",
        "target {target} in image {image} is {px} px off: its centre is wrong (a reflection or dirt"
        " on the dot?)",
        target=target_id, image=image, px=off,
    )  # fmt: skip


def all_wrong(problem: Problem, rms_px: float, worst_machine_mm: float) -> Words:
    """Return words for observations that fit no pose, without one to blame."""
    return keyed(
        "said.contradict",
        "all: the images contradict each other by {px} px, more than a machine whose geometry errs"
        " by {mm} mm (worst_machine_mm) explains, and leaving out one image or target does not"
        " mend it: check that part file, calibration and spindle poses belong together.",
        px=f"{rms_px:.1f}", mm=f"{worst_machine_mm:g}",
    )  # fmt: skip


def cannot_tell(rms_px: float, worst_machine_mm: float) -> Words:
    """Return words for a contradiction among too few observations."""
    return keyed(
        "said.contradict_few",
        "all: the images contradict each other by {px} px, more than a machine whose geometry errs"
        " by {mm} mm (worst_machine_mm) explains, and there are too few to tell which is wrong:"
        " take another image of each target.",
        px=f"{rms_px:.1f}", mm=f"{worst_machine_mm:g}",
    )  # fmt: skip


def cannot_tell_which(words: Sequence[Words]) -> Words:
    """Return words for several explanations of which any may be true."""
    return keyed(
        "said.contradict_which",
        "all: the images contradict each other, and there are too few to tell which is wrong."
        " Either {which}. Take another image of each.",
        which=alternatives(words),
    )


def alternatives(words: Sequence[Words]) -> Words:
    """Return "one; or another"."""
    told = words[0]
    for following in words[1:]:
        told = keyed("said.or_else", "{first}; or {second}", first=told, second=following)
    return told


def either(words: Sequence[Words]) -> Words:
    """Return what was found: one thing, or several of which any may be true."""
    if len(words) == 1:
        return words[0]
    return keyed("said.either", "either {which}", which=alternatives(words))


def cannot_leave_out(words: Words) -> Words:
    """Return words for something wrong without which too little is left."""
    return keyed(
        "said.cannot_leave_out",
        "all: {what}; without it there are too few images to solve: take it anew, or more images"
        " of the other targets.",
        what=words,
    )


def failed(error: Exception) -> Words:
    """Return words for a computation that failed."""
    return keyed("said.failed", "all: {why}.", why=verbatim(str(error)))


MIRRORED = keyed(
    "said.mirrored",
    "all: the images are mirrored left to right (mirrored they fit): switch off the camera's"
    " ReverseX or mirror setting.",
)


def _pixels(
    problem: Problem, images: Indices, X_mm: Array, best: Adjustment
) -> tuple[Array, Array]:
    """Return pixels (N, 2) of points X - X_0 (N, 3) in images (N,), and d(pixel)/dX (N, 2, 3).

    NaN where an image does not show the point.
    """
    pixels, by_unknowns = np.empty((len(images), 2)), np.empty((len(images), 2, 7))
    points = np.ascontiguousarray(X_mm)[:, None, :]
    asked = replace(problem, image_of=images, target_of=np.arange(len(images)), points=points)
    predict_all(
        asked.model(circles=False), best.rotation, best.d0_mm, best.gamma_s_rad,
        pixels, by_unknowns,
    )  # fmt: skip
    return pixels, by_unknowns[:, :, 3:6] @ best.rotation


def _off_px(problem: Problem, indices: Indices, best: Adjustment) -> Array:
    """Return how far off centres are, (n,)."""
    X = problem.points[problem.target_of[indices], 0]
    expected, _ = _pixels(problem, problem.image_of[indices], X, best)
    return np.nan_to_num(np.hypot(*(problem.measured[indices] - expected).T), nan=1e6)


def _pose_of_another_image(problem: Problem, indices: Indices, best: Adjustment) -> int | None:
    """Return the stamp of the image whose pose explains what was seen, if there is one."""
    image = problem.image_of[indices[0]]
    if np.any(problem.image_of[indices] != image):
        return None
    count, seen = len(problem.stamps_ns), len(indices)
    X = problem.points[problem.target_of[indices], 0]
    expected, _ = _pixels(problem, np.repeat(np.arange(count), seen), np.tile(X, (count, 1)), best)
    off = np.hypot(*(expected.reshape(count, seen, 2) - problem.measured[indices]).T)
    near = np.all(off < _SAME_PX, axis=0)
    near[image] = False
    return problem.stamps_ns[int(np.argmax(near))] if near.any() else None


def _shares_pose(problem: Problem, image: int) -> int | None:
    """Return the stamp of another image that was given the same pose, if there is one."""
    moved = np.linalg.norm(problem.d_cnc - problem.d_cnc[image], axis=1)
    turned = np.abs(problem.R_cnc - problem.R_cnc[image]).max(axis=(1, 2))
    same = (moved < _SAME_MM) & (turned < _SAME_RAD)
    same[image] = False
    return problem.stamps_ns[int(np.argmax(same))] if same.any() else None


def _misread(problem: Problem, index: int, best: Adjustment) -> int | None:
    """Return the part's target that should be where another was read, if there is one."""
    X = np.array([target.xyz_mm for target in problem.part.targets]) - problem.X0_mm
    expected, _ = _pixels(problem, np.full(len(X), problem.image_of[index]), X, best)
    distance = np.nan_to_num(np.hypot(*(expected - problem.measured[index]).T), nan=1e6)
    nearest = int(np.argmin(distance))
    found = problem.part.targets[nearest].id
    read = problem.target_ids[problem.target_of[index]]
    return found if distance[nearest] < _SAME_PX and found != read else None


def _bumped(problem: Problem, indices: Indices, best: Adjustment) -> Words:
    """Describe where a target is, by least squares of the rays to it."""
    target = int(problem.target_of[indices[0]])
    X = problem.points[target, 0].copy()
    for _ in range(5):
        expected, by_point = _pixels(
            problem, problem.image_of[indices], np.tile(X, (len(indices), 1)), best
        )
        off = problem.measured[indices] - expected
        if not np.all(np.isfinite(off)):
            X[:] = np.nan
            break
        X += np.linalg.lstsq(by_point.reshape(-1, 3), off.ravel(), rcond=1e-6)[0]
    moved = X - problem.points[target, 0]
    target_id = problem.target_ids[target]
    if not np.all(np.isfinite(moved)):
        return keyed(
            "said.not_there", "target {target} is not where the part file has it", target=target_id
        )
    return keyed(
        "said.bumped",
        "target {target} is {mm} mm from where the part file has it (x {x}, y {y}, z {z} mm): was"
        " it bumped?",
        target=target_id, mm=f"{np.linalg.norm(moved):.2f}",
        x=f"{moved[0]:+.2f}", y=f"{moved[1]:+.2f}", z=f"{moved[2]:+.2f}",
    )  # fmt: skip
