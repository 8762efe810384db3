"""From messages (m, rad) to the screen's facts (mm, rad), and pictures for the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from omm_interfaces.msg import PartEstimate, SpindleState, TargetObservations
from omm_interfaces.srv import WorkOffset
from sensor_msgs.msg import Image

from omm_core.words import Words, with_beside
from omm_operator.screen.facts import (
    ControlFact,
    EstimateFact,
    FoundFact,
    HealthFact,
    ImageFact,
    OffsetFact,
    PictureFact,
    ResidualFact,
)
from omm_ros.conversions import MM_PER_M, image_from_message, stamp_ns
from omm_ros.diagnostics import SAID

LARGEST_PX = 1280
_SHOWN_IMAGES = 8  # of which residuals may be drawn
_QUALITY = 80
_UNIT = np.array([1.0, 1.0, 1.0, MM_PER_M, MM_PER_M, MM_PER_M, 1.0])


def estimate_fact(message: PartEstimate) -> EstimateFact:
    """Return an estimate as the screen takes it."""
    covariance = np.asarray(message.covariance).reshape(7, 7) * np.outer(_UNIT, _UNIT)
    newest = {(i.stamp.sec, i.stamp.nanosec) for i in message.images[-_SHOWN_IMAGES:]}
    return EstimateFact(
        part=message.part,
        model=message.model,
        determined=message.determined,
        converged=message.converged,
        theta=np.asarray(message.theta) * _UNIT,
        covariance=covariance,
        expanded_uncertainty=np.asarray(message.expanded_uncertainty) * _UNIT,
        stamp_ns=stamp_ns(message.header.stamp),
        rms_px=message.rms_px,
        sigma0=message.sigma0,
        degrees_of_freedom=message.degrees_of_freedom,
        images=tuple(
            ImageFact(
                stamp_ns=stamp_ns(i.stamp),
                used=i.used,
                reason=with_beside(i.reason, i.reason_said),
                pending=i.pending,
            )
            for i in message.images
        ),
        images_pending=message.images_pending,
        targets=tuple((t.id, t.images) for t in message.targets),
        residuals=tuple(
            ResidualFact(
                stamp_ns=stamp_ns(o.stamp),
                target_id=o.target_id,
                center_px=(o.col_px, o.row_px),
                residual_px=(float(o.residual_px[0]), float(o.residual_px[1])),
                used=o.used,
                reason=with_beside(o.reason, o.reason_said),
            )
            for o in message.observations
            if (o.stamp.sec, o.stamp.nanosec) in newest
        ),
        missing=_all_words(message.missing, message.missing_said),
        findings=_all_words(message.findings, message.findings_said),
        remarks=_all_words(message.remarks, message.remarks_said),
        clamping=message.clamping,
        revoked=message.revoked,
        revoked_reason=with_beside(message.revoked_reason, message.revoked_said),
        shares=_shares(message),
    )


def _all_words(texts: Sequence[str], said: Sequence[str]) -> tuple[Words, ...]:
    """Return words with the keys that stand beside them; without, where there are none."""
    beside = [*said, *[""] * len(texts)]
    return tuple(with_beside(text, key) for text, key in zip(texts, beside, strict=False))


def _shares(message: PartEstimate) -> dict[str, NDArray[np.float64]]:
    """Return the shares by source; none where they are not one for each unknown."""
    sources, shares = list(message.share_sources), np.asarray(message.shares, dtype=float)
    if len(shares) != 7 * len(sources):
        return {}
    return dict(zip(sources, shares.reshape(-1, 7), strict=True))


def control_fact(message: SpindleState) -> ControlFact:
    """Return the control's state as the screen takes it; axes as they are, in m and rad."""
    return ControlFact(
        control=message.control,
        connection=message.connection,
        detail=with_beside(message.connection_detail, message.connection_said),
        program_state=message.program_state,
        program=message.program,
        program_line=message.program_line,
        in_position=message.in_position,
        moving_reason=with_beside(message.moving_reason, message.moving_said),
        measure_requested=message.measure_requested,
        measure_request=message.measure_request,
        measure_acknowledged=message.measure_acknowledged,
        axes=tuple(zip(message.axis_names, map(float, message.axis_positions))),
    )


def health_fact(status: DiagnosticStatus) -> HealthFact:
    """Return a line of diagnostics as the screen takes it."""
    node, _, name = status.name.partition(": ")
    values = {value.key: value.value for value in status.values}
    return HealthFact(
        node=node,
        name=name,
        level=int.from_bytes(status.level, "little"),
        message=with_beside(status.message, values.pop(SAID, "")),
        values=values,
    )


def found_fact(message: TargetObservations) -> FoundFact:
    """Return what was found in an image as the screen takes it."""
    return FoundFact(
        stamp_ns=stamp_ns(message.header.stamp),
        targets=tuple((t.id, t.col_px, t.row_px) for t in message.targets),
        refused=tuple(
            (r.col_px, r.row_px, with_beside(r.reason, r.reason_said)) for r in message.refused
        ),
    )


def picture_fact(message: Image, number: int) -> PictureFact:
    """Return an image as a JPEG of at most 1280 px.

    Raises
    ------
    InputError
        Where the image is none that omm takes.
    """
    import cv2

    pixels = image_from_message(message)
    height, width = pixels.shape
    shown = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)
    scale = LARGEST_PX / max(height, width)
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        shown = np.asarray(cv2.resize(shown, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, jpeg = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return PictureFact(
        number=number,
        stamp_ns=stamp_ns(message.header.stamp),
        width_px=width,
        height_px=height,
        jpeg=jpeg.tobytes(),
    )


def offset_request(name: str, wanted: OffsetFact | None) -> WorkOffset.Request:
    """Return what the bridge is asked: to read an offset, or to write it."""
    request = WorkOffset.Request(name=name, write=wanted is not None)
    if wanted is not None:
        request.position = np.asarray(wanted.xyz_mm) / MM_PER_M
        request.euler_xyz = np.asarray(wanted.euler_xyz_rad)
    return request


def offset_fact(name: str, response: WorkOffset.Response) -> OffsetFact:
    """Return what the bridge has read."""
    x, y, z = (float(value) * MM_PER_M for value in response.position)
    a, b, c = (float(angle) for angle in response.euler_xyz)
    return OffsetFact(name=name, xyz_mm=(x, y, z), euler_xyz_rad=(a, b, c))
