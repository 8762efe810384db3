"""Say what is wrong with observations: what would explain where they were seen?"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.estimation.adjustment import Adjustment
from omm_core.estimation.fit import Fit
from omm_core.estimation.problem import Problem
from omm_core.geometry import spindle_T_taper

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
    off = float(np.max(np.hypot(*(_seen(problem, indices, without.best)[0]).T)))
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


def all_wrong(problem: Problem, rms_px: float) -> str:
    """Return words for observations that fit no pose, without one to blame."""
    return (
        f"all: the images contradict each other by {rms_px:.1f} px, and leaving out one image or"
        " target does not mend it: check that part file, calibration and spindle poses belong"
        " together."
    )


def cannot_tell(sigma0: float) -> str:
    """Return words for a contradiction among too few observations."""
    return (
        f"all: the images contradict each other ({sigma0:.0f} times what their uncertainties"
        " explain), and there are too few to tell which is wrong: take another image of each"
        " target."
    )


MIRRORED = (
    "all: the images are mirrored left to right (mirrored they fit): switch off the camera's"
    " ReverseX or mirror setting."
)


def _project(problem: Problem, image: int, X_mm: Array, best: Adjustment) -> Array:
    """Return pixels (N, 2) of points X - X_0 (N, 3) with the pose of an image."""
    holder = spindle_T_taper(best.gamma_s_rad) @ problem.calibration.taper_T_camera
    in_machine = X_mm @ best.rotation.T + best.d0_mm
    in_spindle = (in_machine - problem.d_cnc[image]) @ problem.R_cnc[image]
    return problem.calibration.lens.project(holder.inverse() @ in_spindle)


def _seen(problem: Problem, indices: NDArray[np.int64], best: Adjustment) -> tuple[Array, Array]:
    """Return how far off the centres are (N, 2), and where they were measured (N, 2)."""
    expected = np.array(
        [
            _project(problem, problem.image_of[i], problem.points[problem.target_of[i]], best)[0]
            for i in indices
        ]
    )
    return np.nan_to_num(problem.measured[indices] - expected, nan=1e6), problem.measured[indices]


def _pose_of_another_image(
    problem: Problem, indices: NDArray[np.int64], best: Adjustment
) -> int | None:
    """Return the stamp of the image whose pose explains what was seen, if there is one."""
    image = problem.image_of[indices[0]]
    if np.any(problem.image_of[indices] != image):
        return None
    X = problem.points[problem.target_of[indices], 0]
    for other in range(len(problem.stamps_ns)):
        expected = _project(problem, other, X, best)
        near = np.hypot(*(expected - problem.measured[indices]).T) < _SAME_PX
        if other != image and near.all():
            return problem.stamps_ns[other]
    return None


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
    expected = _project(problem, int(problem.image_of[index]), X, best)
    distance = np.nan_to_num(np.hypot(*(expected - problem.measured[index]).T), nan=1e6)
    nearest = int(np.argmin(distance))
    found = problem.part.targets[nearest].id
    read = problem.target_ids[problem.target_of[index]]
    return found if distance[nearest] < _SAME_PX and found != read else None


def _bumped(problem: Problem, indices: NDArray[np.int64], best: Adjustment) -> str:
    """Say where a target is, by least squares of the rays to it."""
    target = int(problem.target_of[indices[0]])
    X = problem.points[target, 0].copy()
    for _ in range(5):
        expected, slopes = [], []
        for index in indices:
            image = int(problem.image_of[index])
            around = _project(problem, image, np.vstack([X, X + 0.1 * np.eye(3)]), best)
            expected.append(problem.measured[index] - around[0])
            slopes.append((around[1:] - around[0]).T / 0.1)
        step = np.linalg.lstsq(np.concatenate(slopes), np.concatenate(expected), rcond=1e-6)[0]
        X += step
    moved = X - problem.points[target, 0]
    target_id = problem.target_ids[target]
    if not np.all(np.isfinite(moved)):
        return f"target {target_id} is not where the part file has it"
    return (
        f"target {target_id} is {np.linalg.norm(moved):.2f} mm from where the part file has it"
        f" (x {moved[0]:+.2f}, y {moved[1]:+.2f}, z {moved[2]:+.2f} mm): was it bumped?"
    )
