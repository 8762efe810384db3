"""A measuring session: images and spindle poses in, the pose of the part out.

The estimator node and ``./omm solve`` both use :class:`Measurement`. Its result is a function of
the set of images and poses, so that both come to the same numbers, to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.session.pairing import PairedPose, PairingOptions, PoseTrack
from omm_core.targets.coded.families import TargetFamily, mirror_code
from omm_core.words import Words, image_number, keyed

if TYPE_CHECKING:
    from omm_core.part_pose import Observation, Solution, SolveOptions
    from omm_core.session.result import ImageOutcome, MeasurementResult, ObservationOutcome
    from omm_core.targets import Detection

_NOT_IN_PART = keyed("said.not_in_part", "not a target of the part")
_LEFT_OUT = keyed("said.on_request", "left out on request")
_NO_TARGET = keyed("said.no_target", "no target was found")
_NO_PART_TARGET = keyed("said.no_part_target", "no target of the part was found")
_MORE_THAN_ONCE = keyed("said.more_than_once", "the number was found more than once in this image")
_NOTHING_SOLVED = keyed("said.nothing_solved", "nothing could be solved yet")


class FoundTarget(Protocol):
    """What a measurement needs to know of a detected target."""

    @property
    def id(self) -> int:
        """Number in the family."""

    @property
    def center_px(self) -> Any:
        """(col, row)."""

    @property
    def covariance_px2(self) -> Any:
        """(2, 2)."""


@dataclass(frozen=True, kw_only=True)
class MeasurementOptions:
    """How to pair, detect and solve; None: the defaults of each."""

    pairing: PairingOptions = field(default_factory=PairingOptions)
    solve: SolveOptions | None = None
    detection: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """One target in one image, as numbers that can be compared."""

    target_id: int
    center_px: tuple[float, float]
    covariance_px2: tuple[float, float, float, float]


class Measurement:
    """Images and poses of one clamping of one part.

    Parameters
    ----------
    part : Part
    calibration : CameraCalibration
    options : MeasurementOptions
    """

    def __init__(
        self,
        part: Part,
        calibration: CameraCalibration,
        options: MeasurementOptions | None = None,
    ) -> None:
        self.part = part
        self.calibration = calibration
        self.options = options or MeasurementOptions()
        self._family = TargetFamily.by_name(part.target_family)
        self._poses = PoseTrack(self.options.pairing)
        self._images: dict[int, set[tuple[_Seen, ...] | Words]] = {}
        self._left_out: frozenset[int] = frozenset()
        self._solved: tuple[Any, Solution] | None = None
        self._counted = 0

    def add_pose(self, stamp_ns: int, machine_T_spindle: RigidTransform) -> None:
        """Add where the spindle was at a time; in any order."""
        self._poses.add(stamp_ns, machine_T_spindle)

    def forget_poses(self, before_ns: int) -> None:
        """Drop the poses before a time that no image is judged by: a node may run for weeks."""
        self._poses.forget(before_ns, self._images)

    def add_image(self, stamp_ns: int, image: NDArray[np.uint8] | NDArray[np.uint16]) -> Detection:
        """Find the targets in an image (H, W) and add them.

        Raises
        ------
        InputError
            Where the image is not of the calibration's sensor.
        """
        detection = self.detect(image)
        self.add_detection(stamp_ns, detection.targets)
        return detection

    def detect(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> Detection:
        """Find the targets in an image (H, W) without adding them; several threads may do so.

        Raises
        ------
        InputError
            Where the image is not of the calibration's sensor.
        """
        from omm_core.targets import DetectionOptions, detect_targets

        self.calibration.check_image_shape(image.shape)
        options = self.options.detection or DetectionOptions()
        return detect_targets(image, self._family, options)

    def add_detection(self, stamp_ns: int, targets: Iterable[FoundTarget]) -> None:
        """Add the targets found in an image."""
        seen = (
            _Seen(
                target_id=int(target.id),
                center_px=_floats(target.center_px),
                covariance_px2=_floats(target.covariance_px2),
            )
            for target in targets
        )
        ordered = tuple(sorted(seen, key=lambda s: (s.target_id, s.center_px)))
        self._add(stamp_ns, ordered)

    def add_refused_image(self, stamp_ns: int, reason: Words) -> None:
        """Record an image that could not be used at all."""
        self._add(stamp_ns, reason)

    def _add(self, stamp_ns: int, content: tuple[_Seen, ...] | Words) -> None:
        versions = self._images.setdefault(stamp_ns, set())
        if not any(_same(content, known) for known in versions):
            versions.add(content)

    def leave_out(self, stamps_ns: Iterable[int]) -> None:
        """Leave out the images of these stamps, and no others, from now on."""
        self._left_out = frozenset(stamps_ns)

    def knows(self, stamp_ns: int) -> bool:
        """Tell whether an image of that stamp was added."""
        return stamp_ns in self._images

    def solve_with(self, options: SolveOptions) -> None:
        """Solve with other options from now on; what was measured stays."""
        self.options = replace(self.options, solve=options)
        self._solved = None

    @property
    def images_pending(self) -> int:
        """Return how many images still wait for spindle poses after them."""
        return sum(self._poses.judge(stamp_ns).pending for stamp_ns in self._images)

    def result(self) -> MeasurementResult:
        """Solve from all images that can be used; account for all of them."""
        from omm_core.session.result import MeasurementResult

        accepted: dict[int, tuple[_Seen, ...]] = {}
        refused: dict[int, Words] = {}
        judgements = {stamp_ns: self._poses.judge(stamp_ns) for stamp_ns in self._images}
        for stamp_ns in sorted(self._images):
            content = self._content(stamp_ns, accepted)
            reason = content if isinstance(content, str) else judgements[stamp_ns].reason
            if reason is not None:
                refused[stamp_ns] = reason
            elif not isinstance(content, str):
                accepted[stamp_ns] = content
        solution = self._solve(accepted, judgements)
        outcomes = self._observation_outcomes(accepted, refused, solution)
        images = self._image_outcomes(accepted, refused, judgements, outcomes)
        counts = {target.id: 0 for target in self.part.targets}
        # Until there is a solution, what was seen in sound images counts as used.
        seen = (
            [o.target_id for o in outcomes if o.used]
            if solution.determined
            else [s.target_id for content in accepted.values() for s in self._usable(content)]
        )
        for target_id in seen:
            counts[target_id] += 1
        mirrored = self._mirrored()
        return MeasurementResult(
            part_name=self.part.name,
            solution=solution,
            images=images,
            observations=outcomes,
            images_per_target={target.id: counts[target.id] for target in self.part.targets},
            findings=(*mirrored, *solution.findings),
            missing=(*(mirrored if solution.missing else ()), *solution.missing),
        )

    def _content(
        self, stamp_ns: int, earlier: dict[int, tuple[_Seen, ...]]
    ) -> tuple[_Seen, ...] | Words:
        """Return the targets of an image, or why it cannot be used whatever its pose."""
        versions = self._images[stamp_ns]
        if stamp_ns in self._left_out:
            return _LEFT_OUT
        if len(versions) > 1:
            return keyed(
                "said.same_stamp", "{n} different images carry this stamp", n=len(versions)
            )
        (content,) = versions
        if isinstance(content, str):
            return content
        if not content:
            return _NO_TARGET
        if not any(self.part.target(seen.target_id) for seen in content):
            return _NO_PART_TARGET
        for other, known in earlier.items():
            # Two exposures are never equal to the last digit: the camera sent one of them twice.
            if _same(content, known):
                return keyed(
                    "said.sent_again",
                    "the camera sent image {image} again",
                    image=image_number(other, sorted(self._images)),
                )
        return content

    def _usable(self, content: tuple[_Seen, ...]) -> list[_Seen]:
        ids = [seen.target_id for seen in content]
        return [
            seen
            for seen in content
            if self.part.target(seen.target_id) and ids.count(seen.target_id) == 1
        ]

    def _solve(
        self, accepted: dict[int, tuple[_Seen, ...]], judgements: dict[int, PairedPose]
    ) -> Solution:
        from omm_core.part_pose import Observation, solve
        from omm_core.session.extrapolation import extrapolation_words

        observations: list[Observation] = []
        for stamp_ns, content in accepted.items():
            pose = judgements[stamp_ns].machine_T_spindle
            assert pose is not None
            observations.extend(
                Observation(
                    stamp_ns=stamp_ns,
                    target_id=seen.target_id,
                    center_px=np.array(seen.center_px),
                    covariance_px2=np.array(seen.covariance_px2).reshape(2, 2),
                    machine_T_spindle=pose,
                )
                for seen in self._usable(content)
            )
        key = [
            (o.stamp_ns, o.target_id, tuple(o.machine_T_spindle.translation_mm.tolist()),
             tuple(o.machine_T_spindle.rotation.ravel().tolist()))
            for o in observations
        ]  # fmt: skip
        if self._solved is None or self._solved[0] != key or self._counts_otherwise():
            solution = solve(
                observations, self.part, self.calibration, self.options.solve, run_ns=self._images
            )
            outside = extrapolation_words(solution, self.part, self.calibration)
            solution = replace(solution, remarks=(*solution.remarks, *outside))
            self._solved = (key, solution)
            self._counted = len(self._images)
        return self._solved[1]

    def _counts_otherwise(self) -> bool:
        """Return whether what was found wrong counts images that are more by now."""
        assert self._solved is not None
        named = any(self._solved[1].findings) or any(self._solved[1].reasons)
        return named and self._counted != len(self._images)

    def _observation_outcomes(
        self,
        accepted: dict[int, tuple[_Seen, ...]],
        refused: dict[int, Words],
        solution: Solution,
    ) -> tuple[ObservationOutcome, ...]:
        from omm_core.session.result import ObservationOutcome

        solved = {(o.stamp_ns, o.target_id): i for i, o in enumerate(solution.observations)}
        position_among_used = np.cumsum(solution.used) - 1
        outcomes = []
        for stamp_ns in sorted(self._images):
            for seen in self._all_seen(stamp_ns):
                index = solved.get((stamp_ns, seen.target_id)) if stamp_ns in accepted else None
                used = index is not None and bool(solution.used[index])
                reason = None if used else self._why_not(stamp_ns, seen, index, refused, solution)
                values: dict[str, float] = {}
                if used and index is not None and solution.statistics is not None:
                    s, k = solution.statistics, int(position_among_used[index])
                    values = {
                        "redundancy": float(s.redundancy[k]),
                        "w_test": float(s.w_test[k]),
                        "smallest_detectable_px": float(s.smallest_detectable_px[k]),
                        "external_sigma": float(s.external_sigma[k]),
                    }
                residual = (np.nan, np.nan) if index is None else solution.residuals_px[index]
                outcomes.append(
                    ObservationOutcome(
                        stamp_ns=stamp_ns,
                        target_id=seen.target_id,
                        center_px=seen.center_px,
                        residual_px=(float(residual[0]), float(residual[1])),
                        used=used,
                        reason=reason,
                        **values,
                    )
                )
        return tuple(outcomes)

    def _all_seen(self, stamp_ns: int) -> tuple[_Seen, ...]:
        versions = [v for v in self._images[stamp_ns] if not isinstance(v, str)]
        return versions[0] if len(versions) == 1 else ()

    def _why_not(
        self,
        stamp_ns: int,
        seen: _Seen,
        index: int | None,
        refused: dict[int, Words],
        solution: Solution,
    ) -> Words:
        if self.part.target(seen.target_id) is None:
            return _NOT_IN_PART
        if stamp_ns in refused:
            return refused[stamp_ns]
        if index is None:
            return _MORE_THAN_ONCE
        return solution.reasons[index] or _NOTHING_SOLVED

    def _image_outcomes(
        self,
        accepted: dict[int, tuple[_Seen, ...]],
        refused: dict[int, Words],
        judgements: dict[int, PairedPose],
        outcomes: tuple[ObservationOutcome, ...],
    ) -> tuple[ImageOutcome, ...]:
        from omm_core.session.result import ImageOutcome

        # Sound images count as used even while there are too few of them to solve.
        left_out = {o.stamp_ns: o.reason for o in outcomes if not o.used}
        with_used = {o.stamp_ns for o in outcomes if o.used}
        solvable = bool(with_used)
        images = []
        for stamp_ns in sorted(self._images):
            used = stamp_ns in accepted and (stamp_ns in with_used or not solvable)
            reason = None if used else refused.get(stamp_ns) or left_out.get(stamp_ns)
            pending = judgements[stamp_ns].pending
            images.append(
                ImageOutcome(stamp_ns=stamp_ns, used=used, reason=reason, pending=pending)
            )
        return tuple(images)

    def _mirrored(self) -> tuple[Words, ...]:
        """Tell images whose numbers make sense only when read the other way round."""
        part_ids = {target.id for target in self.part.targets}
        read = {seen.target_id for stamp in self._images for seen in self._all_seen(stamp)}
        family = self._family
        as_read, turned = 0, 0
        for target_id in read:
            if not 1 <= target_id <= len(family):
                continue
            other = family.id_of(mirror_code(family.code_of(target_id), family.bits))
            if other != target_id:
                as_read += target_id in part_ids
                turned += other in part_ids
        if turned < 2 or turned <= as_read:
            return ()
        return (
            keyed(
                "said.numbers_mirrored",
                "all: the numbers of the targets make sense only in mirrored images: switch off the"
                " camera's ReverseX or mirror setting.",
            ),
        )


def _floats(values: Any) -> Any:
    return tuple(float(value) for value in np.asarray(values, dtype=float).ravel())


def _same(one: tuple[_Seen, ...] | Words, other: tuple[_Seen, ...] | Words) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return [(s.target_id, s.center_px) for s in one] == [(s.target_id, s.center_px) for s in other]
