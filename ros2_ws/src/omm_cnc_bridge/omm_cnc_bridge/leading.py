"""Leads the measuring program of the node: finds in, corrections out (see guiding.py)."""

from __future__ import annotations

from omm_interfaces.msg import TargetObservations
from rclpy.node import Node

from omm_cnc_bridge import conversions
from omm_cnc_bridge.control import Control, ControlSample, ProgramState, TakesCorrections
from omm_cnc_bridge.guiding import Guiding, GuidingFiles
from omm_cnc_bridge.handshake import Acknowledge
from omm_cnc_bridge.parameters import Parameters
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics
from omm_ros import qos, topics
from omm_ros.conversions import stamp_ns

_RUNNING = (ProgramState.RUNNING, ProgramState.WAITING, ProgramState.INTERRUPTED)
_WORDS = ("as planned", "corrected", "nothing seen, look again")


class Leading:
    """Tells the program with each answer where its next stop shall be; nothing without a plan."""

    def __init__(self, node: Node, control: Control, p: Parameters, machine: Kinematics) -> None:
        self._log = node.get_logger()
        self._control = control if isinstance(control, TakesCorrections) else None
        self._guiding: Guiding | None = None
        if not p.plan_file:
            return
        if self._control is None:
            self._log.warning(f"plan_file: {p.control} takes no corrections of its stops")
            return
        files = GuidingFiles(
            plan_file=p.plan_file, part_file=p.part_file, calibration_file=p.calibration_file
        )
        self._guiding = Guiding.load(files, machine, round(p.find_timeout_s * 1e9))
        node.create_subscription(
            TargetObservations, topics.OBSERVATIONS, self._on_observations, qos.OBSERVATIONS
        )

    def connected(self) -> None:
        """Withdraw what an earlier bridge told: it must not be taken for ours."""
        if self._control is not None:
            self._control.correct((0.0, 0.0, 0.0), 0, valid=False)

    def is_ready(self, image_ns: int, now_ns: int) -> bool:
        """Return whether an image may be answered."""
        return self._guiding is None or self._guiding.is_ready(image_ns, now_ns)

    def heard(self, sample: ControlSample) -> None:
        """Take in whether the program runs."""
        if self._guiding is not None:
            self._guiding.heard(running=sample.program_state in _RUNNING)

    def before_answer(self, action: Acknowledge, machine_T_spindle: RigidTransform | None) -> None:
        """Tell the program where its next stop shall be. Raises DeviceError if not connected."""
        if self._guiding is None or self._control is None:
            return
        told = (
            None
            if machine_T_spindle is None
            else self._guiding.correction(action.request, action.image_ns, machine_T_spindle)
        )
        if told is None:
            self._log.warning(
                f"image {action.request}: no word of the estimator; the program goes on as planned"
            )
            self._control.correct((0.0, 0.0, 0.0), 0, valid=False)
            return
        self._control.correct(told.shift_mm, told.status, valid=True)
        x, y, z = told.shift_mm
        self._log.info(f"image {action.request}: {_WORDS[told.status]}, {x:.1f} {y:.1f} {z:.1f} mm")

    def _on_observations(self, message: TargetObservations) -> None:
        assert self._guiding is not None
        stamp = stamp_ns(message.header.stamp)
        self._guiding.observed(stamp, conversions.found_targets(message))
