"""The camera of the simulated cell: renders what it would see from where the spindle truly is.

It behaves as a real one: an exposure lasts, its middle is the stamp, a trigger that comes during an
exposure is refused by waiting, and in continuous mode images come at a fixed rate for as long as
rendering keeps up; those that it cannot keep up with are missing from the sequence.
"""

import time
from collections.abc import Mapping
from typing import Any

from omm_camera_driver.clocks import WallClock
from omm_camera_driver.driver import Camera, CameraSettings, Frame, Trigger, check_range
from omm_camera_driver.drivers.simulated.cell_view import CellView
from omm_camera_driver.drivers.simulated.true_poses import TruePoses
from omm_core.errors import InputError

_EXPOSURE_RANGE_US = (10.0, 1_000_000.0)
_RATE_RANGE_HZ = (0.1, 1000.0)
_DEFAULT_RATE_HZ = 5.0
_POSE_TIMEOUT_S = 1.0


class SimulatedDriver:
    """A camera that renders.

    Parameters
    ----------
    view : what it sees
    poses : where the spindle truly is
    wall : the system's clock; the schedule of the exposures is the monotonic one's
    """

    def __init__(self, view: CellView, poses: TruePoses, wall: WallClock | None = None) -> None:
        self._wall = wall or WallClock()
        self._view = view
        self._poses = poses
        self._exposure_us = view.exposure_ns / 1e3
        self._bits = 8
        self._rate_hz = _DEFAULT_RATE_HZ
        self._continuous = True
        self._next_ns: int | None = None
        self._sequence = 0
        self._render_ms = 0.0

    def open(self, settings: CameraSettings) -> Camera:
        """Take the settings over; there is always a simulated camera."""
        if settings.trigger is Trigger.HARDWARE:
            raise InputError(
                "Expected the trigger to be continuous or software, got hardware: the simulated "
                "camera has no lines. Use the simulated GigE camera's, or a real one."
            )
        if settings.exposure_us is not None:
            self.set("exposure_us", settings.exposure_us)
        if settings.frame_rate_hz is not None:
            check_range("frame_rate_hz", settings.frame_rate_hz, *_RATE_RANGE_HZ, unit="Hz")
            self._rate_hz = settings.frame_rate_hz
        if settings.pixel_format is not None:
            self._bits = _bits_of(settings.pixel_format)
        self._continuous = settings.trigger is Trigger.CONTINUOUS
        self._view.warm_up()
        granted = {"exposure_us": self._exposure_us, "frame_rate_hz": self._rate_hz}
        return Camera(
            vendor="omm",
            model="simulated camera",
            serial=self._view.name,
            address="simulation",
            has_software_trigger=True,
            granted=granted,
        )

    def start(self) -> None:
        """Begin: with the first exposure at once, or with none before a trigger."""
        self._next_ns = time.monotonic_ns() if self._continuous else None

    def flush(self) -> None:
        """Forget what has been triggered and not been fetched."""
        if not self._continuous:
            self._next_ns = None

    def trigger(self) -> None:
        """Begin an exposure now."""
        self._next_ns = time.monotonic_ns()

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Wait for the end of the exposure and render it."""
        due_ns = self._next_ns
        exposure_ns = round(self._exposure_us * 1000)
        wait_s = timeout_s if due_ns is None else _seconds_until(due_ns + exposure_ns)
        if due_ns is None or wait_s > timeout_s:
            time.sleep(max(0.0, timeout_s))
            return None
        time.sleep(wait_s)
        self._sequence += 1
        self._schedule(due_ns)
        self._wall.look()
        begin_ns = self._wall.system_ns(due_ns)
        mid_ns = begin_ns + exposure_ns // 2
        pose_at = self._poses.during(begin_ns, begin_ns + exposure_ns, _POSE_TIMEOUT_S)
        started_s = time.monotonic()
        self._view.place_part(self._poses.machine_T_part)
        image = self._view.render(
            pose_at, mid_ns, exposure_ns, frame=self._sequence, bits=self._bits
        )
        self._render_ms = (time.monotonic() - started_s) * 1e3
        return Frame(
            image=image,
            exposure_mid_ns=mid_ns,
            exposure_ns=exposure_ns,
            stamp_uncertainty_ns=0,
            sequence=self._sequence,
        )

    def check(self) -> None:
        """Do nothing: the simulated camera never goes away."""

    def set(self, name: str, value: float) -> float:
        """Change the exposure; the simulated light is kept constant, so the image stays as bright.

        Raises
        ------
        InputError
            Out of range, or a setting that this camera does not have.
        """
        if name != "exposure_us":
            raise InputError(f"Expected exposure_us, got {name}: the simulated camera has no more.")
        check_range(name, value, *_EXPOSURE_RANGE_US, unit="µs")
        self._exposure_us = value
        return value

    def health(self) -> Mapping[str, Any]:
        """Return how long rendering takes."""
        return {"rendering_ms": round(self._render_ms, 1)}

    def close(self) -> None:
        """Do nothing: no device is held."""

    def _schedule(self, due_ns: int) -> None:
        if not self._continuous:
            self._next_ns = None
            return
        period_ns = round(1e9 / self._rate_hz)
        skipped = max(0, (time.monotonic_ns() - due_ns) // period_ns - 1)
        self._sequence += skipped
        self._next_ns = due_ns + (1 + skipped) * period_ns


def _seconds_until(monotonic_ns: int) -> float:
    return max(0.0, (monotonic_ns - time.monotonic_ns()) / 1e9)


def _bits_of(pixel_format: str) -> int:
    bits = {"Mono8": 8, "Mono16": 16}.get(pixel_format)
    if bits is None:
        raise InputError(f"Expected pixel_format Mono8 or Mono16, got {pixel_format}.")
    return bits
