"""Judged samples as ROS messages: mm become m, integers become the message's constants."""

import math

import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped
from numpy.typing import NDArray
from omm_interfaces.msg import SpindleState, TargetObservations

from omm_cnc_bridge.control import Connection
from omm_cnc_bridge.judgement import JudgedSample
from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics
from omm_core.words import Words, beside, keyed
from omm_ros.conversions import MM_PER_M, pose_from_transform, time_from_ns, transform_message

MACHINE_FRAME = "machine"
SPINDLE_FRAME = "spindle"
NO_SAMPLE = keyed("said.no_sample", "no sample yet")


def pose_message(stamp_ns: int, machine_T_spindle: RigidTransform) -> PoseStamped:
    """Return the pose, stamped with when it was true."""
    message = PoseStamped(pose=pose_from_transform(machine_T_spindle))
    message.header.stamp = time_from_ns(stamp_ns)
    message.header.frame_id = MACHINE_FRAME
    return message


def spindle_transform(stamp_ns: int, machine_T_spindle: RigidTransform) -> TransformStamped:
    """Return the spindle's pose as /tf wants it."""
    message = TransformStamped(transform=transform_message(machine_T_spindle))
    message.header.stamp = time_from_ns(stamp_ns)
    message.header.frame_id = MACHINE_FRAME
    message.child_frame_id = SPINDLE_FRAME
    return message


def state_message(
    control: str,
    connection: Connection,
    detail: Words,
    judged: JudgedSample | None,
    machine: Kinematics,
) -> SpindleState:
    """Return the control's state as of the last sample; it is current only while connected."""
    message = SpindleState(
        control=control,
        connection=int(connection),
        connection_detail=detail,
        connection_said=beside(detail),
        program_line=-1,
        spindle_angle=math.nan,
    )
    message.header.frame_id = MACHINE_FRAME
    _set_moving(message, detail or NO_SAMPLE)
    if judged is None:
        return message
    sample = judged.sample
    connected = connection is Connection.CONNECTED
    message.header.stamp = time_from_ns(sample.stamp_ns)
    message.stamp_uncertainty = sample.stamp_uncertainty_ns / 1e9
    message.mode = int(sample.mode)
    message.program_state = int(sample.program_state)
    message.program, message.program_line = sample.program, sample.program_line
    message.spindle_orientation = int(sample.orientation)
    message.spindle_angle = sample.spindle_angle_rad
    scales = {a.name: 1.0 if a.rotary else 1.0 / MM_PER_M for a in machine.axes}
    for axis, scale in scales.items():
        message.axis_names.append(axis)
        message.axis_positions.append(judged.axes.get(axis, math.nan) * scale)
        message.axis_commanded.append(sample.commanded.get(axis, math.nan) * scale)
    message.in_position = connected and not judged.moving_reason
    _set_moving(message, judged.moving_reason if connected else detail)
    message.measure_requested = connected and sample.measure_request is not None
    message.measure_request = sample.measure_request or 0
    return message


def _set_moving(message: SpindleState, why: Words) -> None:
    message.moving_reason, message.moving_said = why, beside(why)


def found_targets(message: TargetObservations) -> dict[int, tuple[NDArray[np.float64], float]]:
    """Return, by number, each found target's centre (2,) and diameter, px."""
    return {
        target.id: (np.array([target.col_px, target.row_px]), target.diameter_px)
        for target in message.targets
    }
