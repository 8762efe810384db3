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
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from omm_core.calibration import CameraCalibration, load_calibration
from omm_core.errors import InputError
from omm_core.measurement import Measurement, MeasurementOptions
from omm_core.pairing import PairingOptions
from omm_core.part import Part, load_part
from omm_recorder.decoding import (
    IMAGE_TYPE,
    POSE_TYPE,
    image_pixels,
    machine_T_spindle,
    stamp_ns,
)
from omm_recorder.reading import RecordedMessage, Recording

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omm_core.result import MeasurementResult
    from omm_core.targets import Detection

ESTIMATE = "/omm/estimate"


@dataclass(frozen=True, kw_only=True)
class SolveRunOptions:
    """What to solve with; what is not given is taken from the run."""

    part_file: Path | None = None
    calibration_file: Path | None = None
    model: str = "7d"
    gamma_s_rad: float = 0.0
    pairing: PairingOptions = field(default_factory=PairingOptions)
    without: frozenset[int] = frozenset()
    """Stamps (ns) of images to leave out."""
    image_topic: str = "/camera/image_raw"
    pose_topic: str = "/cnc/spindle_pose"
    threads: int = 0
    """Images looked at side by side; 0: one for each core."""


@dataclass(frozen=True, kw_only=True)
class RecordedEstimate:
    """The live estimator's last word in the recording."""

    model: str
    theta_si: tuple[float, ...]
    """(alpha, beta, gamma, x, y, z, gamma_s), rad and m; NaN where not determined."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedRun:
    """A recording and what came out of it."""

    run: Path
    options: SolveRunOptions
    part: Part
    calibration: CameraCalibration
    result: "MeasurementResult"
    recorded: RecordedEstimate | None
    notices: tuple[str, ...]
    """What people should know of how it was solved."""

    def images(self) -> Iterator[tuple[int, "NDArray[np.generic]"]]:
        """The images with their stamps (ns), read anew from the recording."""
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
    notices: list[str] = []
    with Recording(run) as recording:
        recording.require(options.image_topic, IMAGE_TYPE)
        recording.require(options.pose_topic, POSE_TYPE)
        part = _part(recording, options.part_file, notices)
        calibration = _calibration(recording, options.calibration_file, notices)
        measurement = Measurement(part, calibration, _measurement_options(options))
        _feed(recording, measurement, options)
        recorded = _recorded_estimate(recording)
    return SolvedRun(
        run=run,
        options=options,
        part=part,
        calibration=calibration,
        result=measurement.result(),
        recorded=recorded,
        notices=tuple(notices),
    )


def _measurement_options(options: SolveRunOptions) -> MeasurementOptions:
    from omm_core.estimation import SolveOptions

    model: Any = options.model
    solve = SolveOptions(model=model, gamma_s_rad=options.gamma_s_rad)
    return MeasurementOptions(pairing=options.pairing, solve=solve)


def _feed(recording: Recording, measurement: Measurement, options: SolveRunOptions) -> None:
    """Give all poses and images to the measurement; several images are searched at once."""
    threads = options.threads or len(os.sched_getaffinity(0))
    waiting: deque[tuple[int, Future[Detection]]] = deque()
    stamps: set[int] = set()

    def take_first() -> None:
        stamp, found = waiting.popleft()
        measurement.add_detection(stamp, found.result().targets)

    with ThreadPoolExecutor(threads) as pool:
        for message in recording.messages([options.image_topic, options.pose_topic]):
            if message.topic == options.pose_topic:
                pose = recording.decode(message)
                measurement.add_pose(stamp_ns(pose), machine_T_spindle(pose))
                continue
            image = recording.decode(message)
            stamp = stamp_ns(image)
            stamps.add(stamp)
            if stamp in options.without:
                measurement.add_refused_image(stamp, "left out on request")
                continue
            waiting.append((stamp, pool.submit(_detect, measurement, image_pixels(image))))
            if len(waiting) > 2 * threads:  # images are large: not all of them at once
                take_first()
        while waiting:
            take_first()
    unknown = options.without - stamps
    if unknown:
        raise InputError(
            f"Expected stamps of recorded images to leave out, got {min(unknown)}. "
            f"There are: {', '.join(map(str, sorted(stamps)))}."
        )


def _detect(measurement: Measurement, image: "NDArray[np.generic]") -> "Detection":
    return measurement.detect(image)


def _part(recording: Recording, named: Path | None, notices: list[str]) -> Part:
    return load_part(named) if named else _load(recording, "part.yaml", load_part, notices)


def _calibration(recording: Recording, named: Path | None, notices: list[str]) -> CameraCalibration:
    if named:
        return load_calibration(named)
    return _load(recording, "camera.yaml", load_calibration, notices)


def _load(recording: Recording, name: str, load: Any, notices: list[str]) -> Any:
    """Load a file that was not named: the one beside the recording, or else the one inside."""
    inside = recording.attachment(name)
    beside = recording.run.beside(name)
    if beside is not None:
        if inside is not None and inside != beside.read_bytes():
            notices.append(
                f"{beside} is not the {name} that was recorded with the run; it is used "
                f"all the same. The recorded one: ./omm export {recording.run.folder}"
            )
        return load(beside)
    if inside is None:
        option = {"part.yaml": "--part", "camera.yaml": "--calibration"}[name]
        raise InputError(
            f"Expected {name} beside {recording.run.recordings[0]} or in it, found none. "
            f"Name one: {option} FILE"
        )
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(inside)
        return load(path)


def _recorded_estimate(recording: Recording) -> RecordedEstimate | None:
    """The last estimate that the live node published."""
    last: RecordedMessage | None = None
    if ESTIMATE in recording.topics:
        for message in recording.messages([ESTIMATE]):
            last = message
    if last is None:
        return None
    estimate = recording.decode(last)
    theta_si = tuple(float(value) for value in estimate.theta)
    return RecordedEstimate(model=str(estimate.model), theta_si=theta_si)
