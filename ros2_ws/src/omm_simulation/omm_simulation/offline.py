"""A whole run without waiting and without ROS: poses and images as the live nodes would send them.

The part of the CNC bridge and of the camera driver is played here in a few lines: the image is
triggered when the program asks for it and the axes have arrived, and acknowledged when it is in.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_simulation.camera import SimulatedCamera
from omm_simulation.cell import Cell
from omm_simulation.control import SimulatedControl
from omm_simulation.control_state import ControlState

ARRIVED_MM = 0.001
"""|command − actual| below which the axes have arrived."""
TRIGGER_LATENCY_S = 0.005
READOUT_S = 0.06
POSES_MISSING_S = 0.3
TOO_EARLY_S = 0.1


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What goes wrong in a run; images are named by their number in the program, from 1.

    (A target that is not where the part file says is a fault of the cell: `cell.draw`.)

    Attributes
    ----------
    mirrored : bool
        The camera delivers all images mirrored.
    without_poses : set of int
        No poses arrive from when the image is asked for until 0.3 s after it.
    moving : set of int
        The image is taken 0.1 s before the axes have arrived.
    stale : set of int
        The camera delivers the image before it once more, with a new stamp.
    """

    mirrored: bool = False
    without_poses: frozenset[int] = field(default_factory=frozenset)
    moving: frozenset[int] = field(default_factory=frozenset)
    stale: frozenset[int] = field(default_factory=frozenset)


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseMessage:
    """A pose as the bridge publishes it, and the state that it is taken from."""

    stamp_ns: int
    machine_T_spindle: RigidTransform
    state: ControlState


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageMessage:
    """An image as the camera publishes it.

    Attributes
    ----------
    stamp_ns : int
        Middle of the exposure.
    image : ndarray of uint8 or uint16, shape (H, W)
    request : int
        Number in the program.
    target_id : int
        What the program was after.
    true_machine_T_spindle : tuple of RigidTransform
        Where the spindle truly was during the exposure.
    """

    stamp_ns: int
    image: NDArray[Any]
    request: int
    target_id: int
    true_machine_T_spindle: tuple[RigidTransform, ...]


def run(
    cell: Cell,
    *,
    faults: Faults | None = None,
    pose_rate_hz: float = 100.0,
    start_ns: int = 1_700_000_000_000_000_000,
    speed_factor: float = 1.0,
    bits: int = 8,
    noise: bool = True,
) -> Iterator[PoseMessage | ImageMessage]:
    """Measure a cell: all messages in the order in which they would arrive.

    Parameters
    ----------
    cell : Cell
    faults : Faults, optional
    pose_rate_hz : float
    start_ns : int
        Time of the first pose; the program starts 0.3 s later.
    speed_factor : float
        See `SimulatedControl`.
    bits : int
        Of the images, 8 or 16.
    noise : bool
        Of the images.
    """
    control = SimulatedControl(cell, start_ns=start_ns + 300_000_000, speed_factor=speed_factor)
    trigger = _Trigger(cell, control, faults or Faults(), bits=bits, noise=noise)
    sample, end_ns = 0, None
    while end_ns is None or start_ns + round(sample / pose_rate_hz * 1e9) < end_ns:
        now_ns = start_ns + round(sample / pose_rate_hz * 1e9)
        state = control.state(now_ns)
        trigger.watch(state)
        if trigger.poses_arrive(now_ns):
            yield PoseMessage(
                stamp_ns=now_ns, machine_T_spindle=state.machine_T_spindle, state=state
            )
        if (image := trigger.delivered(now_ns)) is not None:
            control.acknowledge(image.request, now_ns)
            yield image
        if end_ns is None and control.finished(now_ns):
            end_ns = now_ns + 500_000_000
        sample += 1


class _Trigger:
    """Has an image taken at each stop that the program asks for one, or goes wrong as told."""

    def __init__(
        self, cell: Cell, control: SimulatedControl, faults: Faults, *, bits: int, noise: bool
    ) -> None:
        self._camera = SimulatedCamera(cell)
        self._exposure_s = cell.scenario.imaging.exposure_s
        self._stops = cell.stops
        self._control = control
        self._faults = faults
        self._bits, self._noise = bits, noise
        self._pending: tuple[int, ImageMessage] | None = None
        self._last: ImageMessage | None = None
        self._arrived_ns = 0
        self._poseless_until_ns = 0

    def watch(self, state: ControlState) -> None:
        """Take the image that is asked for, once the axes have arrived."""
        if not state.in_position:
            self._arrived_ns = state.stamp_ns
        done = self._last.request if self._last else 0
        off_mm = np.abs(state.axis_positions_mm - state.axis_commanded_mm).max()
        if not state.measure_requested or state.measure_request == done or off_mm > ARRIVED_MM:
            return
        begin_ns = state.stamp_ns + round(TRIGGER_LATENCY_S * 1e9)
        stamp_ns = begin_ns + round(self._exposure_s * 0.5e9)
        delivered_ns = begin_ns + round((self._exposure_s + READOUT_S) * 1e9)
        if state.measure_request in self._faults.without_poses:
            self._poseless_until_ns = stamp_ns + round(POSES_MISSING_S * 1e9)
        self._last = self._take(stamp_ns, state.measure_request)
        self._pending = delivered_ns, self._last

    def delivered(self, now_ns: int) -> ImageMessage | None:
        """Return the image that has been read out by now, once."""
        if self._pending is None or now_ns < self._pending[0]:
            return None
        _, image = self._pending
        self._pending = None
        return image

    def poses_arrive(self, now_ns: int) -> bool:
        return now_ns >= self._poseless_until_ns

    def _take(self, stamp_ns: int, request: int) -> ImageMessage:
        if request in self._faults.moving:
            stamp_ns = self._arrived_ns - round(TOO_EARLY_S * 1e9)
        poses = self._camera.exposure_poses(self._control.true_machine_T_spindle, stamp_ns)
        if request in self._faults.stale and self._last is not None:
            poses = self._last.true_machine_T_spindle
        image: NDArray[Any] = self._camera.image(
            poses, frame=request, bits=self._bits, noise=self._noise
        )
        if self._faults.mirrored:
            image = np.ascontiguousarray(image[:, ::-1])
        return ImageMessage(
            stamp_ns=stamp_ns,
            image=image,
            request=request,
            target_id=self._stops[(request - 1) % len(self._stops)].target_id,
            true_machine_T_spindle=poses,
        )
