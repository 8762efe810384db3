"""A measurement as markers for RViz and Foxglove: part, targets, uncertainty, camera's view."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, TransformStamped
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform, quaternion_xyzw_from_rotation
from omm_core.imaging.calibration import CameraCalibration
from omm_core.machine.urdf import Joint, Robot
from omm_operator.screen.facts import EstimateFact
from omm_ros.conversions import MM_PER_M, transform_message

Array = NDArray[np.float64]
_ENOUGH = 2  # images of a target
_UNSEEN, _ONCE, _SEEN = (0.6, 0.6, 0.6, 1.0), (0.95, 0.7, 0.1, 1.0), (0.1, 0.7, 0.25, 1.0)
_PART, _DOUBT, _VIEW = (0.45, 0.6, 0.8, 0.25), (0.85, 0.15, 0.2, 0.55), (0.9, 0.9, 0.2, 0.8)
_COVERAGE = 2.0


def part_markers(
    estimate: EstimateFact, part: Part, *, part_frame: str, machine_frame: str, enlargement: float
) -> MarkerArray:
    """Return the part where it was measured, its targets by how often they were seen, ellipsoids.

    Without a pose that holds, only what removes the markers from before.
    """
    if not estimate.holds:
        return MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
    low, high = part.box()
    box = _marker(part_frame, "part", 0, Marker.CUBE, _PART)
    _place(box, (low + high) / 2.0, np.maximum(high - low, 1.0))
    seen = dict(estimate.targets)
    targets = [
        marker
        for number, target in enumerate(part.targets)
        for marker in _target(
            part_frame, number, target.xyz_mm, target.dot_diameter_mm, target.id,
            seen.get(target.id, 0),
        )
    ]  # fmt: skip
    doubts = [
        _ellipsoid(machine_frame, number, estimate, corner, enlargement)
        for number, corner in enumerate(part.box_corners())
    ]
    return MarkerArray(markers=[box, *targets, *doubts])


def camera_view(calibration: CameraCalibration, frame: str, depth_mm: float) -> MarkerArray:
    """Return the pyramid that the camera sees, up to a depth."""
    width, height = calibration.width_px, calibration.height_px
    pixels = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    rays = calibration.lens.rays(pixels)
    far = depth_mm * rays / rays[:, 2:3]
    lines = [(np.zeros(3), corner) for corner in far]
    lines += [(far[k], far[(k + 1) % 4]) for k in range(4)]
    marker = _marker(frame, "camera", 0, Marker.LINE_LIST, _VIEW)
    marker.scale.x = 0.002
    marker.points = [_point(end) for line in lines for end in line]
    return MarkerArray(markers=[marker])


def link_frames(
    robot: Robot, positions: Mapping[str, float], stamp: Time, tip: str
) -> list[TransformStamped]:
    """Return where the links of a machine are, each from the root.

    Not from link to link, as robot_state_publisher does: the tip has its frame from the bridge,
    and a frame with two parents jumps between them.

    Parameters
    ----------
    positions : mapping
        Of the axes, m and rad. A link that hangs on one that is missing is left out.
    stamp : Time
        When they were there.
    tip : str
        The link that the bridge tells.
    """
    frames = []
    for link in robot.links:
        chain = robot.chain(link)
        moved = [joint for joint in chain if joint.movable]
        told = [positions.get(joint.name, math.nan) for joint in moved]
        if link in (robot.root, tip) or not np.all(np.isfinite(told)):
            continue
        matrix = np.eye(4)
        for joint in chain:
            matrix = matrix @ joint.origin @ _motion(joint, positions.get(joint.name, 0.0))
        pose = RigidTransform(rotation=matrix[:3, :3], translation_mm=matrix[:3, 3])
        frame = TransformStamped(transform=transform_message(pose), child_frame_id=link)
        frame.header.frame_id, frame.header.stamp = robot.root, stamp
        frames.append(frame)
    return frames


def _motion(joint: Joint, position: float) -> Array:
    matrix = np.eye(4)
    if joint.movable and joint.rotary:
        x, y, z = joint.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
        matrix[:3, :3] += turn
    elif joint.movable:
        matrix[:3, 3] = joint.axis * position * MM_PER_M
    return matrix


def place_covariance_mm2(estimate: EstimateFact, point_mm: Array) -> Array:
    """Return the covariance of a part's point in the machine, (3, 3): how well its place is known.

    From the covariance of α, β, γ, x, y, z: ``p = R(α, β, γ) X + d``, derived numerically.
    """
    theta = np.asarray(estimate.theta[:6], dtype=float)
    jacobian = np.hstack([np.zeros((3, 3)), np.eye(3)])
    step = 1e-6
    for k in range(3):
        ends = [
            RigidTransform.from_euler_xyz_rad(*(theta[:3] + sign * step * np.eye(3)[k])).rotation
            for sign in (1.0, -1.0)
        ]
        jacobian[:, k] = (ends[0] - ends[1]) @ point_mm / (2.0 * step)
    return np.asarray(jacobian @ estimate.covariance[:6, :6] @ jacobian.T)


def _target(
    frame: str, number: int, xyz_mm: Array, diameter_mm: float, target_id: int, images: int
) -> Iterable[Marker]:
    color = _SEEN if images >= _ENOUGH else _ONCE if images else _UNSEEN
    dot = _marker(frame, "targets", number, Marker.SPHERE, color)
    _place(dot, xyz_mm, np.full(3, diameter_mm))
    name = _marker(frame, "target numbers", number, Marker.TEXT_VIEW_FACING, color)
    _place(name, xyz_mm + [0.0, 0.0, 2.0 * diameter_mm], np.full(3, 2.0 * diameter_mm))
    name.text = str(target_id)
    return dot, name


def _ellipsoid(
    frame: str, number: int, estimate: EstimateFact, point_mm: Array, enlargement: float
) -> Marker:
    """Return where a corner may be (k = 2), enlarged."""
    squares, axes = np.linalg.eigh(place_covariance_mm2(estimate, point_mm))
    axes[:, 0] *= np.sign(np.linalg.det(axes))  # eigenvectors may be left-handed
    marker = _marker(frame, "uncertainty", number, Marker.SPHERE, _DOUBT)
    radii = _COVERAGE * np.sqrt(np.maximum(squares, 0.0)) * enlargement
    _place(marker, estimate.machine_T_part() @ point_mm, np.maximum(2.0 * radii, 0.01), axes)
    return marker


def _marker(
    frame: str, name: str, number: int, kind: int, color: tuple[float, float, float, float]
) -> Marker:
    marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD)
    marker.header.frame_id = frame
    marker.header.stamp = Time()  # the newest transform, whenever it is shown
    marker.pose.orientation.w = 1.0
    red, green, blue, alpha = color
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def _place(marker: Marker, middle_mm: Array, size_mm: Array, axes: Array | None = None) -> None:
    marker.pose.position = _point(np.asarray(middle_mm, dtype=float))
    marker.scale.x, marker.scale.y, marker.scale.z = (np.asarray(size_mm) / MM_PER_M).tolist()
    if axes is not None:
        o = marker.pose.orientation
        o.x, o.y, o.z, o.w = (float(q) for q in quaternion_xyzw_from_rotation(axes))


def _point(xyz_mm: Array) -> Point:
    x, y, z = (xyz_mm / MM_PER_M).tolist()
    return Point(x=x, y=y, z=z)
