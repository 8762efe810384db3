"""Between the core's results (mm, rad) and messages (m, rad)."""

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from numpy.typing import NDArray
from omm_interfaces.msg import (
    ImageStatus,
    PartEstimate,
    RefusedTarget,
    ResidualStatus,
    TargetObservation,
    TargetObservations,
    TargetStatus,
)
from std_msgs.msg import Header

from omm_core.geometry import RigidTransform, holder_rotation, rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose.posterior import PoseStatement
from omm_core.session.result import MeasurementResult
from omm_core.targets import Detection
from omm_core.words import NOTHING, Words, beside
from omm_estimator.stored import StoredResult
from omm_ros.conversions import MM_PER_M, pose_from_transform, time_from_ns, transform_message

Array = NDArray[np.float64]

# θ = (α, β, γ, x, y, z, γ_s): what a metre or a radian is in the core's units.
_UNIT = np.array([1.0, 1.0, 1.0, MM_PER_M, MM_PER_M, MM_PER_M, 1.0])


def theta_si(told: PoseStatement) -> Array:
    """Return θ in rad and m; NaN where it is not determined."""
    return np.asarray(told.theta) / _UNIT


def covariance_si(told: PoseStatement) -> Array:
    """Return the covariance of θ, (7, 7), rad and m."""
    return np.asarray(told.covariance) / np.outer(_UNIT, _UNIT)


def expanded_uncertainty_si(told: PoseStatement) -> Array:
    """Return U of θ, (7,), rad and m."""
    return np.asarray(told.expanded_uncertainty) / _UNIT


def _machine_T_part(theta: Array) -> RigidTransform:
    alpha, beta, gamma = theta[:3]
    xyz_mm = theta[3:6]
    return RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, xyz_mm)


def estimate_message(
    result: MeasurementResult, clamping: int, revoked_reason: Words = NOTHING
) -> PartEstimate:
    """Return the whole result as /omm/estimate, with the clamping's number since the start.

    With a reason it revokes what was published before.
    """
    solution = result.solution
    newest_ns = max((image.stamp_ns for image in result.images), default=0)
    message = PartEstimate(
        header=Header(stamp=time_from_ns(newest_ns), frame_id="machine"),
        part=result.part_name,
        model=solution.model,
        determined=result.determined,
        converged=bool(solution.converged),
        theta=theta_si(solution.own),
        covariance=covariance_si(solution.own).ravel(),
        expanded_uncertainty=expanded_uncertainty_si(solution.own),
        rms_px=_or_nan(solution.rms_px),
        sigma0=_or_nan(solution.sigma0),
        degrees_of_freedom=int(solution.degrees_of_freedom),
        images_received=len(result.images),
        images_pending=result.images_pending,
        missing=list(result.missing),
        missing_said=[beside(words) for words in result.missing],
        findings=list(result.findings),
        findings_said=[beside(words) for words in result.findings],
        clamping=clamping,
        revoked=bool(revoked_reason),
        revoked_reason=revoked_reason,
        revoked_said=beside(revoked_reason),
        absolute_theta=theta_si(solution.absolute),
        absolute_covariance=covariance_si(solution.absolute).ravel(),
        absolute_expanded_uncertainty=expanded_uncertainty_si(solution.absolute),
        geometry_declared=solution.geometry_declared,
        remarks=list(solution.remarks),
        remarks_said=[beside(words) for words in solution.remarks],
        share_sources=list(solution.shares),
        shares=[float(share) for of in solution.shares.values() for share in of],
    )
    noise = solution.machine
    message.stop_sigma_m = math.nan if noise is None else noise.stop_sigma_mm.median / MM_PER_M
    message.geometry_sigma_m = (
        math.nan if noise is None else noise.geometry_sigma_mm.median / MM_PER_M
    )
    message.machine_estimated = [] if noise is None else list(noise.estimated)
    message.images = _images(result)
    message.targets = [
        TargetStatus(id=target_id, images=images)
        for target_id, images in result.images_per_target.items()
    ]
    message.observations = _residuals(result)
    return message


def _images(result: MeasurementResult) -> list[ImageStatus]:
    return [
        ImageStatus(
            stamp=time_from_ns(i.stamp_ns),
            used=i.used,
            reason=i.reason or "",
            reason_said=beside(i.reason or ""),
            pending=i.pending,
        )
        for i in result.images
    ]


def _residuals(result: MeasurementResult) -> list[ResidualStatus]:
    return [
        ResidualStatus(
            stamp=time_from_ns(o.stamp_ns),
            target_id=o.target_id,
            col_px=o.center_px[0],
            row_px=o.center_px[1],
            residual_px=np.array(o.residual_px),
            used=o.used,
            reason=o.reason or "",
            reason_said=beside(o.reason or ""),
        )
        for o in result.observations
    ]


def pose_message(result: MeasurementResult) -> PoseWithCovarianceStamped:
    """Return the part's pose with ROS's covariance, stamped with the newest image."""
    newest_ns = max(image.stamp_ns for image in result.images)
    return _pose_message(result.solution.theta, covariance_si(result.solution.own), newest_ns)


def stored_pose(stored: StoredResult) -> PoseWithCovarianceStamped:
    """Return the pose of a stored result, as `pose_message` does."""
    covariance = stored.own.covariance / np.outer(_UNIT, _UNIT)
    return _pose_message(stored.own.theta, covariance, stored.stamp_ns)


def stored_estimate(stored: StoredResult) -> PartEstimate:
    """Return a stored result as /omm/estimate; its images are not in it."""
    message = PartEstimate(
        header=Header(stamp=time_from_ns(stored.stamp_ns), frame_id="machine"),
        part=stored.part,
        model=stored.model,
        determined=True,
        converged=True,
        rms_px=stored.rms_px,
        sigma0=stored.sigma0,
        degrees_of_freedom=stored.degrees_of_freedom,
        geometry_declared=stored.geometry_declared,
        stop_sigma_m=math.nan,
        geometry_sigma_m=math.nan,
        remarks=["a stored result, not measured now"],
    )
    for prefix, pose in (("", stored.own), ("absolute_", stored.absolute)):
        setattr(message, f"{prefix}theta", pose.theta / _UNIT)
        covariance = pose.covariance / np.outer(_UNIT, _UNIT)
        setattr(message, f"{prefix}covariance", covariance.ravel())
        setattr(message, f"{prefix}expanded_uncertainty", pose.expanded_uncertainty / _UNIT)
    return message


def _pose_message(
    theta: Array, theta_covariance_si: Array, stamp_ns: int
) -> PoseWithCovarianceStamped:
    """Return a pose with ROS's covariance: x, y, z, rotations about the fixed axes X, Y, Z.

    A change of the Euler angles turns the part by ``ω = E (dα, dβ, dγ)`` about fixed axes, with the
    axes of the three turns as columns of E; so the covariance is mapped, not permuted.
    """
    alpha, beta, gamma = (float(angle) for angle in theta[:3])
    del alpha  # the first turn's axis does not depend on its own angle
    turned_z = rotation_from_euler_xyz_rad(0.0, 0.0, gamma)
    turned_zy = rotation_from_euler_xyz_rad(0.0, beta, gamma)
    axes = np.column_stack([turned_zy[:, 0], turned_z[:, 1], [0.0, 0.0, 1.0]])
    mapping = np.zeros((6, 7))
    mapping[:3, 3:6] = np.eye(3)
    mapping[3:, :3] = axes
    message = PoseWithCovarianceStamped()
    message.header = Header(stamp=time_from_ns(stamp_ns), frame_id="machine")
    message.pose.pose = pose_from_transform(_machine_T_part(theta))
    message.pose.covariance = (mapping @ theta_covariance_si @ mapping.T).ravel()
    return message


def revoked_pose(stamp_ns: int) -> PoseWithCovarianceStamped:
    """Return what replaces a latched pose that no longer holds.

    Its position is NaN, its covariance[0] is -1.
    """
    message = PoseWithCovarianceStamped()
    message.header = Header(stamp=time_from_ns(stamp_ns), frame_id="machine")
    position = message.pose.pose.position
    position.x = position.y = position.z = math.nan
    message.pose.covariance[0] = -1.0
    return message


def camera_frame(calibration: CameraCalibration) -> TransformStamped:
    """Return where the camera sits in the taper, true as long as the calibration is."""
    return _frame("taper", "camera_optical", calibration.taper_T_camera, 0)


def frame_transforms(
    result: MeasurementResult, part_frame: str, stamp_ns: int
) -> list[TransformStamped]:
    """Return what a determined result says of the frames, stamped ``stamp_ns``."""
    return frames_of(result.solution.theta, part_frame, stamp_ns)


def frames_of(theta: Array, part_frame: str, stamp_ns: int) -> list[TransformStamped]:
    """Return what θ (rad, mm) says of the frames, stamped ``stamp_ns``."""
    gamma_s_rad = float(theta[6])
    holder = RigidTransform(rotation=holder_rotation(gamma_s_rad), translation_mm=np.zeros(3))
    return [
        _frame("spindle", "taper", holder, stamp_ns),
        _frame("machine", part_frame, _machine_T_part(theta), stamp_ns),
    ]


def _frame(
    parent: str, child: str, parent_t_child: RigidTransform, stamp_ns: int
) -> TransformStamped:
    return TransformStamped(
        header=Header(stamp=time_from_ns(stamp_ns), frame_id=parent),
        child_frame_id=child,
        transform=transform_message(parent_t_child),
    )


def observations_message(
    header: Header, family: str, shape: tuple[int, ...], detection: Detection
) -> TargetObservations:
    """Return what was found in one image."""
    return TargetObservations(
        header=header,
        target_family=family,
        height_px=shape[0],
        width_px=shape[1],
        targets=[
            TargetObservation(
                id=t.id,
                col_px=float(t.center_px[0]),
                row_px=float(t.center_px[1]),
                covariance_px2=np.asarray(t.covariance_px2).ravel(),
                diameter_px=float(t.diameter_px),
            )
            for t in detection.targets
        ],
        refused=[
            RefusedTarget(
                col_px=r.center_px[0],
                row_px=r.center_px[1],
                reason=r.reason,
                reason_said=beside(r.reason),
            )
            for r in detection.refused
        ],
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)
