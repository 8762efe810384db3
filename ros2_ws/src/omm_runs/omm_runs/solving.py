"""Solves a recording again, without ROS, by the same `Measurement` that the live estimator uses.

What comes out is a function of what was recorded and of the options: not of the machine, the number
of its cores, or the order in which they finish.
"""

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omm_core.errors import InputError
from omm_core.files.machine import Machine, load_machine
from omm_core.files.outside import Text
from omm_core.files.part import Part, load_part
from omm_core.imaging.calibration import CameraCalibration, load_calibration
from omm_core.session.measurement import Measurement
from omm_core.warm_up import warm_up_estimation
from omm_core.words import Words, keyed, of_error, verbatim
from omm_recording.decoding import (
    IMAGE_TYPE,
    POSE_TYPE,
    image_pixels,
    machine_T_spindle,
    stamp_ns,
)
from omm_recording.reading import Recording
from omm_runs.recorded_estimator import (
    RecordedEstimate,
    Settings,
    left_out,
    options_from,
    recorded_estimate,
    recorded_settings,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omm_core.session.result import MeasurementResult
    from omm_core.targets import Detection

MACHINE_FILE = "machine.yaml"

_ON_REQUEST = keyed("said.on_request", "left out on request")


@dataclass(frozen=True, kw_only=True)
class SolveRunOptions:
    """What to solve with; what is not given is as the live estimator had it, or its default."""

    part_file: Path | None = None
    calibration_file: Path | None = None
    machine_file: Path | None = None
    settings: Settings = field(default_factory=dict)
    """Parameters of the estimator that shall differ from those of the run."""
    without: frozenset[int] = frozenset()
    """Stamps (ns) of images to leave out."""
    image_topic: str = "/camera/image_raw"
    pose_topic: str = "/cnc/spindle_pose"
    threads: int = 0
    """Images looked at side by side; 0: one for each core."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedRun:
    """A recording and what came out of it."""

    run: Path
    options: SolveRunOptions
    part: Part
    calibration: CameraCalibration
    machine: Machine | None
    """What was declared of the machine; None: its errors were estimated."""
    result: "MeasurementResult"
    recorded: RecordedEstimate | None
    notices: tuple[Words, ...]
    """What people should know of how it was solved."""

    def images(self) -> Iterator[tuple[int, "NDArray[np.generic]"]]:
        """Yield the images with their stamps (ns), read anew from the recording."""
        with Recording(self.run) as recording:
            for message in recording.messages([self.options.image_topic]):
                image = recording.decode(message)
                yield stamp_ns(image), image_pixels(image)


def solve_run(run: Path, options: SolveRunOptions | None = None) -> SolvedRun:
    """Solve one recording.

    Raises
    ------
    InputError
        If the recording, the part file or the calibration cannot be used.
    """
    options = options or SolveRunOptions()
    notices: list[Words] = []
    with Recording(run) as recording:
        recording.require(options.image_topic, IMAGE_TYPE)
        recording.require(options.pose_topic, POSE_TYPE)
        part = _part(recording, options.part_file, notices)
        calibration = _calibration(recording, options.calibration_file, notices)
        settings = recorded_settings(recording) | options.settings
        recorded = recorded_estimate(recording)
        machine = _machine(recording, options.machine_file, settings, notices)
        measurement = Measurement(part, calibration, options_from(settings, machine))
        measurement.leave_out(left_out(settings))
        forgotten = recorded.forgotten if recorded is not None else frozenset()
        if recorded is not None and recorded.part != part.name:
            notices.append(
                keyed(
                    "said.other_part",
                    "live, the part was {live}; solved is {part}",
                    live=verbatim(recorded.part),
                    part=verbatim(part.name),
                )
            )
        if forgotten:
            notices.append(
                keyed(
                    "said.earlier_clampings",
                    "{n} images of earlier clampings are left out",
                    n=len(forgotten),
                )
            )
        _Feeder(measurement, options, notices).feed(recording, forgotten)
    return SolvedRun(
        run=run,
        options=options,
        part=part,
        calibration=calibration,
        machine=machine,
        result=measurement.result(),
        recorded=recorded,
        notices=tuple(notices),
    )


class _Feeder:
    """Gives all poses and images of a recording to a measurement, as the live estimator does.

    Several images are searched at once; the order in which they end does not matter.
    """

    def __init__(
        self, measurement: Measurement, options: SolveRunOptions, notices: list[Words]
    ) -> None:
        self._measurement = measurement
        self._options = options
        self._notices = notices
        self._threads = options.threads or len(os.sched_getaffinity(0))
        self._waiting: deque[tuple[int, Future[Detection]]] = deque()
        self._stamps: set[int] = set()
        self._bad_images: list[InputError] = []
        self._bad_poses: list[InputError] = []
        self._poses = 0

    def feed(self, recording: Recording, forgotten: frozenset[int]) -> None:
        """Feed everything.

        Raises
        ------
        InputError
            If no pose or no image can be used, or an image to leave out is not there.
        """
        options = self._options
        with ThreadPoolExecutor(self._threads) as pool:
            solver_loaded = pool.submit(warm_up_estimation)
            for message in recording.messages([options.image_topic, options.pose_topic]):
                content = recording.decode(message)
                stamp = stamp_ns(content)
                if message.topic == options.pose_topic:
                    self._take_pose(stamp, content)
                elif stamp not in forgotten:
                    self._take_image(stamp, content, pool)
            while self._waiting:
                self._take_found()
            solver_loaded.result()
        self._check()

    def _take_pose(self, stamp: int, pose: Any) -> None:
        try:
            self._measurement.add_pose(stamp, machine_T_spindle(pose))
            self._poses += 1
        except InputError as error:
            self._bad_poses.append(error)

    def _take_image(self, stamp: int, image: Any, pool: ThreadPoolExecutor) -> None:
        self._stamps.add(stamp)
        if stamp in self._options.without:
            self._measurement.add_refused_image(stamp, _ON_REQUEST)
            return
        found = pool.submit(lambda: self._measurement.detect(image_pixels(image)))
        self._waiting.append((stamp, found))
        if len(self._waiting) > 2 * self._threads:  # images are large: not all of them at once
            self._take_found()

    def _take_found(self) -> None:
        stamp, found = self._waiting.popleft()
        try:
            self._measurement.add_detection(stamp, found.result().targets)
        except InputError as error:
            self._measurement.add_refused_image(stamp, of_error(error))
            self._bad_images.append(error)

    def _check(self) -> None:
        unknown = self._options.without - self._stamps
        if unknown:
            raise InputError(
                f"Expected stamps of recorded images to leave out, got {min(unknown)}. "
                f"There are: {', '.join(map(str, sorted(self._stamps)))}."
            )
        if self._bad_images and len(self._bad_images) == len(self._stamps):
            raise self._bad_images[0]
        if self._bad_poses and not self._poses:
            raise self._bad_poses[0]
        if self._bad_poses:
            number = len(self._bad_poses)
            self._notices.append(
                keyed(
                    "said.bad_poses",
                    "warning: {n} spindle poses cannot be used: {why}",
                    n=number,
                    why=of_error(self._bad_poses[0]),
                )
            )


def _part(recording: Recording, named: Path | None, notices: list[Words]) -> Part:
    return load_part(named) if named else _load(recording, "part.yaml", load_part, notices)


def _calibration(
    recording: Recording, named: Path | None, notices: list[Words]
) -> CameraCalibration:
    if named:
        return load_calibration(named)
    return _load(recording, "camera.yaml", load_calibration, notices)


def _machine(
    recording: Recording, named: Path | None, settings: Settings, notices: list[Words]
) -> Machine | None:
    """Load what is declared of the machine: named, or as the live estimator had it.

    Where no estimator was running, the file beside the run serves, too.
    """
    if named:
        return load_machine(named)
    if settings.get("machine_file"):
        inside = recording.attachment(MACHINE_FILE) is not None
        if inside or recording.run.beside(MACHINE_FILE) is not None:
            return _load(recording, MACHINE_FILE, load_machine, notices)
        notices.append(
            keyed(
                "said.machine_not_recorded",
                "live, the machine was that of {file}, which is not in the recording: its errors"
                " are estimated from the run (--machine FILE declares them)",
                file=verbatim(str(settings["machine_file"])),
            )
        )
        return None
    live = any(name in settings for name in ("part_file", "model"))
    if not live and recording.run.beside(MACHINE_FILE) is not None:
        return _load(recording, MACHINE_FILE, load_machine, notices)
    return None


def _load(recording: Recording, name: str, load: Any, notices: list[Words]) -> Any:
    """Load a file that was not named: the one beside the recording, or else the one inside."""
    inside = recording.attachment(name)
    beside = recording.run.beside(name)
    if beside is not None:
        if inside is not None and inside != beside.read_bytes():
            notices.append(
                keyed(
                    "said.not_recorded_file",
                    "{file} is not the {name} that was recorded with the run; it is used all the"
                    " same. The recorded one: ./omm export {folder}",
                    file=verbatim(str(beside)),
                    name=name,
                    folder=verbatim(str(recording.run.folder)),
                )
            )
        return load(beside)
    if inside is None:
        option = {"part.yaml": "--part", "camera.yaml": "--calibration"}[name]
        raise InputError(
            f"Expected {name} beside {recording.run.recordings[0]} or in it, found none. "
            f"Name one: {option} FILE"
        )
    where = f"{name} in {recording.run.recordings[0]}"
    return load(Text(name=where, content=inside, folder=recording.run.folder))
