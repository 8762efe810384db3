"""The node ``overlay``: images with the targets that were found in them, compressed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from omm_interfaces.msg import PartEstimate, TargetObservations
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image

from omm_core.errors import InputError
from omm_ros import qos, topics
from omm_ros.adaptive_subscription import AdaptiveSubscription
from omm_ros.conversions import image_from_message, stamp_ns
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, network_parameter, parameter
from omm_runs.exporting import Mark, draw

_KEPT = 3  # images that may still be drawn into


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """How images with overlay are published."""

    width_px: int = parameter(
        1296, "Images are made smaller to this width; 0 leaves them.", minimum=0, maximum=20_000
    )
    quality: int = parameter(80, "Of the JPEG.", minimum=1, maximum=100)
    residual_scale: float = parameter(
        1000.0, "How many times residuals are enlarged.", minimum=1.0, maximum=1e6
    )
    network: bool = network_parameter()


class OverlayNode(Node):
    """Publishes images with what was found in them, for whoever listens to omm/overlay/compressed.

    First with the targets, and again when their residuals are known.
    """

    def __init__(self) -> None:
        super().__init__("overlay")
        self._p = declare(self, Parameters)
        self._images: dict[int, Image] = {}
        # Named as image_transport names them: viewers ask for omm/overlay.
        self._overlay = self.create_publisher(CompressedImage, topics.OVERLAY, qos.IMAGE)
        self._input = AdaptiveSubscription(self, Image, topics.IMAGE, self._on_image, qos.IMAGE)
        self.create_subscription(
            TargetObservations, topics.OBSERVATIONS, self._on_found, qos.OBSERVATIONS
        )
        self.create_subscription(PartEstimate, topics.ESTIMATE, self._on_estimate, qos.LATCHED)

    def _on_image(self, message: Image) -> None:
        self._images[stamp_ns(message.header.stamp)] = message
        for old in sorted(self._images)[:-_KEPT]:
            del self._images[old]

    def _on_found(self, message: TargetObservations) -> None:
        self._show(stamp_ns(message.header.stamp), found_marks(message))

    def _on_estimate(self, message: PartEstimate) -> None:
        if message.determined and self._images:
            newest = max(self._images)
            marks = estimate_marks(message, newest)
            if marks:
                self._show(newest, marks)

    def _show(self, stamp: int, marks: Sequence[Mark]) -> None:
        image = self._images.get(stamp)
        if image is None or self._overlay.get_subscription_count() == 0:
            return
        try:
            drawn = draw(image_from_message(image), marks, self._p.residual_scale)
        except InputError as error:
            self.get_logger().warning(f"image: {error}", throttle_duration_sec=5.0)
            return
        self._overlay.publish(
            CompressedImage(
                header=image.header,
                format="bgr8; jpeg compressed bgr8",
                data=jpeg(drawn, self._p.width_px, self._p.quality),
            )
        )


def found_marks(message: TargetObservations) -> list[Mark]:
    """Return the targets found in an image, to be drawn."""
    return [
        Mark(target_id=t.id, center_px=(t.col_px, t.row_px), residual_px=None, used=True)
        for t in message.targets
    ]


def estimate_marks(message: PartEstimate, stamp: int) -> list[Mark]:
    """Return the targets of the image of a stamp (ns) with what the estimate says of them."""
    return [
        Mark(
            target_id=o.target_id,
            center_px=(o.col_px, o.row_px),
            residual_px=_finite(o.residual_px),
            used=bool(o.used),
        )
        for o in message.observations
        if stamp_ns(o.stamp) == stamp
    ]


def _finite(residual: Sequence[float]) -> tuple[float, float] | None:
    dx, dy = (float(value) for value in residual)
    return (dx, dy) if np.isfinite([dx, dy]).all() else None


def jpeg(image: NDArray[np.uint8], width_px: int, quality: int) -> bytes:
    """Return an image (height, width, 3) as JPEG, at most so wide (0: as it is)."""
    height, width = image.shape[:2]
    if 0 < width_px < width:
        size = (width_px, max(1, round(height * width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(data.tobytes())


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(OverlayNode, args, parameters=Parameters, threads=1, niceness=5)
