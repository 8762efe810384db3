"""Targets seen in a recording, with the poses of a spindle that demonstrably stood still."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.part_pose import Observation
from omm_core.session.pairing import PoseTrack
from omm_core.targets import DetectedTarget, DetectionOptions, TargetFamily, detect_targets
from omm_core.words import image_number
from omm_recording.decoding import (
    IMAGE_TYPE,
    POSE_TYPE,
    image_pixels,
    machine_T_spindle,
    stamp_ns,
)
from omm_recording.reading import Recording

IMAGE_TOPIC = "/camera/image_raw"
POSE_TOPIC = "/cnc/spindle_pose"


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedObservations:
    """What can be used of a recording, and in words what cannot."""

    observations: tuple[Observation, ...]
    refused: tuple[str, ...]


def observations_of_run(run: Path, part: Part, shape: tuple[int, int]) -> RecordedObservations:
    """Find the part's targets in all images of a recording.

    Parameters
    ----------
    run : path
    part : Part
    shape : (height, width)
        Of the sensor, px.

    Raises
    ------
    InputError
        If the recording cannot be used, or an image is of another sensor.
    """
    poses, found = PoseTrack(), dict[int, tuple[DetectedTarget, ...]]()
    family = TargetFamily.by_name(part.target_family)
    workers = len(os.sched_getaffinity(0))
    waiting: deque[tuple[int, Future[Any]]] = deque()
    with Recording(run) as recording, ThreadPoolExecutor(workers) as pool:
        recording.require(IMAGE_TOPIC, IMAGE_TYPE)
        recording.require(POSE_TOPIC, POSE_TYPE)
        for message in recording.messages([IMAGE_TOPIC, POSE_TOPIC]):
            content = recording.decode(message)
            if message.topic == POSE_TOPIC:
                poses.add(stamp_ns(content), machine_T_spindle(content))
                continue
            waiting.append((stamp_ns(content), pool.submit(_detect(content, family, shape))))
            if len(waiting) > 2 * workers:  # images are large: not all of them at once
                _take(waiting, found)
        while waiting:
            _take(waiting, found)
    return _paired(poses, found, part)


def _detect(content: Any, family: TargetFamily, shape: tuple[int, int]) -> Callable[[], Any]:
    pixels = image_pixels(content)
    if pixels.shape[:2] != shape:
        raise InputError(
            f"Expected images of {shape[1]} x {shape[0]} pixels, as the set says, got"
            f" {pixels.shape[1]} x {pixels.shape[0]}."
        )
    return lambda: detect_targets(pixels, family, DetectionOptions()).targets


def _take(
    waiting: deque[tuple[int, Future[Any]]], found: dict[int, tuple[DetectedTarget, ...]]
) -> None:
    stamp, future = waiting.popleft()
    found[stamp] = tuple(future.result())


def _paired(
    poses: PoseTrack, found: dict[int, tuple[DetectedTarget, ...]], part: Part
) -> RecordedObservations:
    observations, refused = [], []
    run_ns = sorted(found)
    for stamp, targets in sorted(found.items()):
        judgement = poses.judge(stamp)
        if judgement.machine_T_spindle is None:
            refused.append(f"image {image_number(stamp, run_ns)} is not used: {judgement.reason}")
            continue
        ids = [int(target.id) for target in targets]
        usable = [t for t in targets if ids.count(int(t.id)) == 1 and part.target(int(t.id))]
        if not usable:
            refused.append(
                f"image {image_number(stamp, run_ns)} is not used: no target of the part is seen"
            )
        observations += [
            Observation(
                stamp_ns=stamp,
                target_id=int(target.id),
                center_px=np.asarray(target.center_px, dtype=float),
                covariance_px2=np.asarray(target.covariance_px2, dtype=float),
                machine_T_spindle=judgement.machine_T_spindle,
            )
            for target in usable
        ]
    return RecordedObservations(observations=tuple(observations), refused=tuple(refused))
