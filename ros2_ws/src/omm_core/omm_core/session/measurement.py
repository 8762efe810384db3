"""A measuring session: images and spindle poses in, the pose of the part out.

The estimator node and ``./omm solve`` both use :class:`Measurement`. Its result is a function of
the set of images and poses, so that both come to the same numbers, to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.session.images import (
    Content,
    FoundTarget,
    JudgedImage,
    SeenTarget,
    content_of,
    same_content,
    targets_in,
)
from omm_core.session.pairing import PairingOptions, PoseTrack
from omm_core.targets.coded.families import TargetFamily, mirror_code
from omm_core.words import Words, image_number, keyed

if TYPE_CHECKING:
    from omm_core.part_pose import Solution, SolveOptions
    from omm_core.session.result import MeasurementResult
    from omm_core.targets import Detection

_LEFT_OUT = keyed("said.on_request", "left out on request")
_NO_TARGET = keyed("said.no_target", "no target was found")
_NO_PART_TARGET = keyed("said.no_part_target", "no target of the part was found")


@dataclass(frozen=True, kw_only=True)
class MeasurementOptions:
    """How to pair, detect and solve; None: the defaults of each."""

    pairing: PairingOptions = field(default_factory=PairingOptions)
    solve: SolveOptions | None = None
    detection: Any = None


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
        self._images: dict[int, set[Content]] = {}
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
        self._add(stamp_ns, content_of(targets))

    def add_refused_image(self, stamp_ns: int, reason: Words) -> None:
        """Record an image that could not be used at all."""
        self._add(stamp_ns, reason)

    def _add(self, stamp_ns: int, content: Content) -> None:
        versions = self._images.setdefault(stamp_ns, set())
        if not any(same_content(content, known) for known in versions):
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
        from omm_core.session import outcomes
        from omm_core.session.result import MeasurementResult

        images = self._judged()
        solution = self._solve([image for image in images if image.refused is None])
        observations = outcomes.observation_outcomes(images, self.part, solution)
        mirrored = self._mirrored(images)
        return MeasurementResult(
            part_name=self.part.name,
            solution=solution,
            images=outcomes.image_outcomes(images, observations),
            observations=observations,
            images_per_target=outcomes.images_per_target(
                images, observations, self.part, solution.determined
            ),
            findings=(*mirrored, *solution.findings),
            missing=(*(mirrored if solution.missing else ()), *solution.missing),
        )

    def _judged(self) -> list[JudgedImage]:
        """Return all images by stamp, with why they cannot be used."""
        images: list[JudgedImage] = []
        for stamp_ns in sorted(self._images):
            seen, pose = targets_in(self._images[stamp_ns]), self._poses.judge(stamp_ns)
            refused = self._why_refused(stamp_ns, seen, images)
            refused = pose.reason if refused is None else refused
            images.append(JudgedImage(stamp_ns=stamp_ns, seen=seen, pose=pose, refused=refused))
        return images

    def _why_refused(
        self, stamp_ns: int, seen: tuple[SeenTarget, ...], earlier: list[JudgedImage]
    ) -> Words | None:
        """Return why an image cannot be used whatever its pose; None where it can."""
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
        if not seen:
            return _NO_TARGET
        if not any(self.part.target(target.target_id) for target in seen):
            return _NO_PART_TARGET
        for other in earlier:
            # Two exposures are never equal to the last digit: the camera sent one of them twice.
            if other.refused is None and same_content(seen, other.seen):
                return keyed(
                    "said.sent_again",
                    "the camera sent image {image} again",
                    image=image_number(other.stamp_ns, sorted(self._images)),
                )
        return None

    def _solve(self, images: list[JudgedImage]) -> Solution:
        """Solve from the images, anew only where they are others than the last time."""
        from omm_core.part_pose import Observation, solve
        from omm_core.session.extrapolation import extrapolation_words

        observations = [
            Observation(
                stamp_ns=image.stamp_ns,
                target_id=seen.target_id,
                center_px=np.array(seen.center_px),
                covariance_px2=np.array(seen.covariance_px2).reshape(2, 2),
                machine_T_spindle=image.machine_T_spindle,
            )
            for image in images
            for seen in image.usable(self.part)
        ]
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

    def _mirrored(self, images: list[JudgedImage]) -> tuple[Words, ...]:
        """Tell images whose numbers make sense only when read the other way round."""
        part_ids = {target.id for target in self.part.targets}
        read = {seen.target_id for image in images for seen in image.seen}
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
