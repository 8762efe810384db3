"""Name what is wrong with observations: what would explain where they were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.adjustment import Adjustment
from omm_core.part_pose.fit import Fit
from omm_core.part_pose.kernels import predict_all
from omm_core.part_pose.problem import Indices, Problem

Array = NDArray[np.float64]


_SAME_PX = 3.0
_SAME_MM = 0.1
_SAME_RAD = 1e-4


def describe(
    problem: Problem,
    members: NDArray[np.bool_],
    kind: Literal["observation", "image", "target"],
    without: Fit,
) -> str:
    """Return words for wrong observations, given the fit without them."""
    assert without.best is not None
    indices = np.flatnonzero(members)
    if kind == "target":
        return _bumped(problem, indices, without.best)
    other = _pose_of_another_image(problem, indices, without.best)
    images = {int(problem.image_of[index]) for index in indices}
    when = f"the image of {problem.stamps_ns[images.pop()]} ns"
    off = float(np.max(_off_px(problem, indices, without.best)))
    if other is not None:
        return (
            f"the spindle pose given for {when} is not where it was taken: the image fits the pose"
            f" of the image of {other} ns"
        )
    shared = _shares_pose(problem, int(problem.image_of[indices[0]]))
    if shared is not None:
        return (
            f"the spindle pose given for {when} is not where it was taken: it is that of the image"
            f" of {shared} ns"
        )
    if kind == "image":
        return f"all targets in {when} are up to {off:.2f} px off: its spindle pose is wrong"
    target_id = problem.target_ids[problem.target_of[indices[0]]]
    read_as = _misread(problem, int(indices[0]), without.best)
    if read_as is not None:
        return f"target {read_as} was read as {target_id} in {when}"
    alone = np.count_nonzero(problem.image_of == problem.image_of[indices[0]]) == 1
    what = "its centre or the image's spindle pose" if alone else "its centre"
    return (
        f"target {target_id} in {when} is {off:.2f} px off: {what} is wrong (a reflection or dirt"
        " on the dot?)"
    )


def all_wrong(problem: Problem, rms_px: float, worst_machine_mm: float) -> str:
    """Return words for observations that fit no pose, without one to blame."""
    return (
        f"all: the images contradict each other by {rms_px:.1f} px, more than a machine whose"
        f" geometry errs by {worst_machine_mm:g} mm (worst_machine_mm) explains, and leaving out"
        " one image or target does not mend it: check that part file, calibration and spindle"
        " poses belong together."
    )


def cannot_tell(rms_px: float, worst_machine_mm: float) -> str:
    """Return words for a contradiction among too few observations."""
    return (
        f"all: the images contradict each other by {rms_px:.1f} px, more than a machine whose"
        f" geometry errs by {worst_machine_mm:g} mm (worst_machine_mm) explains, and there are too"
        " few to tell which is wrong: take another image of each target."
    )


def cannot_tell_which(words: Sequence[str]) -> str:
    """Return words for several explanations of which any may be true."""
    return (
        "all: the images contradict each other, and there are too few to tell which is wrong."
        f" Either {'; or '.join(words)}. Take another image of each."
    )


def cannot_leave_out(words: str) -> str:
    """Return words for something wrong without which too little is left."""
    return (
        f"all: {words}; without it there are too few images to solve: take it anew, or more images"
        " of the other targets."
    )


MIRRORED = (
    "all: the images are mirrored left to right (mirrored they fit): switch off the camera's"
    " ReverseX or mirror setting."
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
        *asked.model_arguments(circles=False), best.rotation, best.d0_mm, best.gamma_s_rad,
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


def _bumped(problem: Problem, indices: Indices, best: Adjustment) -> str:
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
        return f"target {target_id} is not where the part file has it"
    return (
        f"target {target_id} is {np.linalg.norm(moved):.2f} mm from where the part file has it"
        f" (x {moved[0]:+.2f}, y {moved[1]:+.2f}, z {moved[2]:+.2f} mm): was it bumped?"
    )
