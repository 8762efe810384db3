"""The node ``estimator``: images and spindle poses in, pose of the part out.

Wiring only: what becomes of images and poses is decided by
`omm_core.session.measurement.Measurement`.
All of it is done on one thread, in the order of arrival; poses wait while targets are searched.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from omm_interfaces.msg import PartEstimate, TargetObservations
from omm_interfaces.srv import LeaveOutImage, LoadPart
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from omm_core.errors import InputError, OmmError
from omm_core.files.machine import MachineUncertainty, load_machine
from omm_core.files.part import Part, load_part, looks_like_part
from omm_core.imaging.calibration import load_calibration
from omm_core.imaging.encodings import liberties
from omm_core.session.measurement import Measurement, MeasurementOptions
from omm_core.session.result import MeasurementResult
from omm_core.warm_up import warm_up_detection, warm_up_estimation
from omm_core.words import NOTHING, Words, keyed, listed, of_error, sentences
from omm_estimator import conversions
from omm_estimator.health import estimate_health, image_health
from omm_estimator.parameters import Parameters
from omm_ros import qos, topics
from omm_ros.adaptive_subscription import AdaptiveSubscription
from omm_ros.conversions import image_from_message, stamp_ns, transform_from_pose
from omm_ros.diagnostics import Diagnostics, Health
from omm_ros.frames import prefixed
from omm_ros.lifecycle import transition
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, watch
from omm_ros.preparing import while_preparing
from omm_ros.published import CountingLifecycleNode

_PREPARING = keyed("said.preparing_kernels", "preparing: numerical kernels are loaded or compiled")
_NO_LONGER = keyed("said.no_longer_determined", "no longer determined")
_SETTLE_PERIOD_S = 0.02
# Times what the last update took: after thousands of images, not every one gets its own.
_PAUSE = 4.0
_FRAMES_PERIOD_S = 0.5
_SILENT_S = 2.0  # poses come fifty times a second
_POSES_BETWEEN_FORGETTING = 50_000
_REMEMBERED_NS = 600_000_000_000  # poses of ten minutes, for images that come late


class EstimatorNode(CountingLifecycleNode):
    """Publishes the estimate as soon as it is determined, and again after every image."""

    def __init__(self) -> None:
        super().__init__("estimator")
        self._p = declare(self, Parameters)
        self.failure: OmmError | None = None
        self._machine = MachineUncertainty()
        self._measurement: Measurement | None = None
        self._pending = 0
        self._due = False
        self._pause_until_s = 0.0
        self._clamping = 0
        self._holds = False  # whether a pose that was published still holds
        self._poses = self._bad_poses = 0
        self._image_number = self._missed_images = 0
        self._last: MeasurementResult | None = None
        self._active = False
        self._pose_heard_s = 0.0
        self._estimate = self.create_publisher(PartEstimate, topics.ESTIMATE, qos.LATCHED)
        self._pose = self.create_publisher(PoseWithCovarianceStamped, topics.PART_POSE, qos.LATCHED)
        self._observations = self.create_publisher(
            TargetObservations, topics.OBSERVATIONS, qos.OBSERVATIONS
        )
        # Never on /tf_static: what was latched there would outlive the clamping.
        self._frames = self.create_publisher(TFMessage, topics.TF, qos.STATE)
        self._camera_frame = self.create_publisher(TFMessage, topics.TF_STATIC, qos.LATCHED)
        self._inputs: list[AdaptiveSubscription] = []  # health is told before there are any
        self._preparing = NOTHING
        self._diagnostics = Diagnostics(self)
        self._diagnostics.add("images", self._image_health)
        self._diagnostics.add("estimate", self._estimate_health)
        watch(self, self._p, self._on_parameters)

    # --- transitions ---------------------------------------------------------------------------

    @transition
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read part, calibration and machine, load the kernels; no image counts before that."""
        if self._p.machine_file:
            self._machine = load_machine(self._p.machine_file).uncertainty
        self._begin(self._p.part_file)
        self._preparing = _PREPARING
        while_preparing(self, _PREPARING, _load_kernels, self._diagnostics.publish)
        self._preparing = NOTHING
        self._inputs = [
            AdaptiveSubscription(self, Image, topics.IMAGE, self._on_image, qos.IMAGE),
            AdaptiveSubscription(self, PoseStamped, topics.SPINDLE_POSE, self._on_pose, qos.POSE),
        ]
        self._answers = [
            self.create_service(Trigger, "~/new_clamping", self._on_new_clamping),
            self.create_service(LoadPart, "~/load_part", self._on_load_part),
            self.create_service(LeaveOutImage, "~/leave_out_image", self._on_leave_out_image),
        ]
        self._ticking = [
            self.create_timer(_SETTLE_PERIOD_S, self._on_timer),
            self.create_timer(_FRAMES_PERIOD_S, self._publish_frames),
        ]
        return super().on_configure(state)

    @transition
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take images from now on."""
        self._active = True
        self._pose_heard_s = time.monotonic()
        self._publish()
        return super().on_activate(state)

    @transition
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take no images; what was measured stays."""
        self._active = False
        return super().on_deactivate(state)

    @transition
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything."""
        for subscription in self._inputs:
            subscription.destroy()
        for service in self._answers:
            self.destroy_service(service)
        for timer in self._ticking:
            self.destroy_timer(timer)
        self._revoke(keyed("said.told_to_forget", "the estimator was told to forget everything"))
        self._measurement = self._last = None
        return super().on_cleanup(state)

    # --- inputs --------------------------------------------------------------------------------

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            pose = transform_from_pose(message.pose)
        except InputError as error:
            self._bad_poses += 1
            self.get_logger().warning(f"spindle pose: {error}", throttle_duration_sec=5.0)
            return
        stamp = stamp_ns(message.header.stamp)
        if self._measurement is None:
            return
        self._measurement.add_pose(stamp, pose)
        self._poses += 1
        self._pose_heard_s = time.monotonic()
        if self._poses % _POSES_BETWEEN_FORGETTING == 0:
            self._measurement.forget_poses(stamp - _REMEMBERED_NS)

    def _on_image(self, message: Image, info: dict[str, Any]) -> None:
        self._count_missed(info["publication_sequence_number"] or 0)
        measurement = self._measurement
        if not self._active or measurement is None:
            return
        stamp = stamp_ns(message.header.stamp)
        try:
            image = image_from_message(message)
            if liberty := liberties(message.encoding, message.step):
                self.get_logger().warning(liberty, once=True)
            detection = measurement.detect(image)
        except InputError as error:
            measurement.add_refused_image(stamp, of_error(error))
            self.get_logger().error(f"image: {error}", throttle_duration_sec=5.0)
        else:
            measurement.add_detection(stamp, detection.targets)
            self._observations.publish(
                conversions.observations_message(
                    message.header, measurement.part.target_family, image.shape, detection
                )
            )
        self._due = True
        self._publish_what_is_due()

    def _count_missed(self, number: int) -> None:
        """Count what never came here, because too many waited already, by the camera's numbers."""
        missed = number - self._image_number - 1
        if (
            missed > 0
            and self._image_number > 0
            and self.count_publishers(self.resolve_topic_name(topics.IMAGE)) == 1
        ):
            self._missed_images += missed
            self.get_logger().warning(
                f"{self._missed_images} images came faster than targets are found and were missed",
                throttle_duration_sec=5.0,
            )
        self._image_number = number

    def _on_timer(self) -> None:
        """Publish again when poses that came after an image decide about it."""
        if self._pending and self._measurement is not None:
            self._due |= self._measurement.images_pending < self._pending
        self._publish_what_is_due()

    def _publish_what_is_due(self) -> None:
        if self._due and time.monotonic() >= self._pause_until_s:
            begin_s = time.monotonic()
            self._due = False
            self._publish()
            now_s = time.monotonic()
            self._pause_until_s = now_s + _PAUSE * (now_s - begin_s)

    def _on_new_clamping(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        assert self._measurement is not None
        part, calibration = self._measurement.part, self._measurement.calibration
        self._measurement = None  # nothing is to be published of what is being forgotten
        self._leave_out([])
        self._measurement = Measurement(part, calibration, self._options())
        self._clamping += 1
        self._publish(keyed("said.new_clamping", "new clamping: all images were forgotten"))
        response.success, response.message = True, f"part {part.name}: all images forgotten"
        self.get_logger().info(response.message)
        return response

    def _on_load_part(
        self, request: LoadPart.Request, response: LoadPart.Response
    ) -> LoadPart.Response:
        try:
            part = self._change_part_as_asked(request.part_file)
        except InputError as error:
            response.success, response.message = False, str(error)
            return response
        # So that everybody can see which file it is; the recorder keeps it.
        self.set_parameters([Parameter("part_file", value=request.part_file)])
        self._leave_out([])
        response.success, response.message = True, f"measuring {part.name}"
        return response

    def _on_leave_out_image(
        self, request: LeaveOutImage.Request, response: LeaveOutImage.Response
    ) -> LeaveOutImage.Response:
        stamp, left_out = stamp_ns(request.stamp), set(self._p.left_out_ns)
        if self._measurement is None or not self._measurement.knows(stamp):
            response.message = f"There is no image of {stamp} ns; /omm/estimate lists all."
            return response
        self._leave_out(left_out | {stamp} if request.leave_out else left_out - {stamp})
        what = "is left out" if request.leave_out else "counts again"
        response.success, response.message = True, f"image {stamp} ns {what}"
        self.get_logger().info(response.message)
        return response

    def _leave_out(self, stamps: Iterable[int]) -> None:
        """Set the parameter: so everybody can see it, and the recorder keeps it."""
        if set(stamps) != set(self._p.left_out_ns):
            kind = Parameter.Type.INTEGER_ARRAY
            self.set_parameters([Parameter("left_out_ns", kind, sorted(stamps))])

    def _on_parameters(self, parameters: Parameters) -> None:
        if self._measurement is not None and parameters.part_file != self._p.part_file:
            self._change_part_as_asked(parameters.part_file)
        self._p = parameters
        if self._measurement is not None:
            self._measurement.solve_with(parameters.solve_options(self._machine))
            self._measurement.leave_out(parameters.left_out_ns)
            self._publish()

    # --- outputs -------------------------------------------------------------------------------

    def _change_part_as_asked(self, part_file: str) -> Part:
        """Take the part file that somebody names over the network, who may be anybody.

        What is wrong with it is told to them only where it is a part file at all: what other files
        hold (of which errors quote some) stays on this machine.
        """
        try:
            return self._change_part(part_file)
        except InputError as error:
            if looks_like_part(part_file):
                raise
            print(f"estimator: {error}", file=sys.stderr)
            raise InputError(
                f"Expected a part file, {part_file} is none that can be read. More stands on the"
                " estimator's own output."
            ) from None

    def _change_part(self, part_file: str) -> Part:
        part = self._begin(part_file)
        self._p = replace(self._p, part_file=part_file)
        self._clamping += 1
        self._publish(keyed("said.new_part", "new part: {part}", part=part.name))
        return part

    def _options(self) -> MeasurementOptions:
        return self._p.measurement_options(self._machine)

    def _begin(self, part_file: str) -> Part:
        if not part_file or not self._p.calibration_file:
            raise InputError(
                "Expected the parameters part_file and calibration_file, got "
                f"part_file={part_file!r}, calibration_file={self._p.calibration_file!r}."
            )
        part, calibration = load_part(part_file), load_calibration(self._p.calibration_file)
        self._measurement = Measurement(part, calibration, self._options())
        self._measurement.leave_out(self._p.left_out_ns)
        self._last = None
        camera = conversions.camera_frame(calibration)
        if self._p.publish_tf:
            camera = prefixed(camera, self._p.frame_prefix)
            self._camera_frame.publish(TFMessage(transforms=[camera]))
        return part

    def _publish(self, reason: Words = NOTHING) -> None:
        """Publish the estimate. What was published before and holds no longer is revoked."""
        if self._measurement is None:
            return
        result = self._measurement.result()
        self._pending, self._last = result.images_pending, result
        if not result.determined and self._holds:
            self._revoke(reason or sentences(result.missing) or _NO_LONGER)
            return
        prefix = self._p.frame_prefix
        self._estimate.publish(
            prefixed(conversions.estimate_message(result, self._clamping), prefix)
        )
        if result.determined:
            self._pose.publish(prefixed(conversions.pose_message(result), prefix))
            self._holds = True
            self._publish_frames()

    def _revoke(self, reason: Words) -> None:
        """Replace what is latched and no longer true, so that nobody machines by it."""
        if not self._holds or self._measurement is None:
            return
        self._holds = False
        forgotten = Measurement(
            self._measurement.part, self._measurement.calibration, self._options()
        )
        result = self._measurement.result()
        told = forgotten.result() if result.determined else result
        estimate = conversions.estimate_message(told, self._clamping, reason)
        pose = conversions.revoked_pose(self.get_clock().now().nanoseconds)
        self._estimate.publish(prefixed(estimate, self._p.frame_prefix))
        self._pose.publish(prefixed(pose, self._p.frame_prefix))
        self.get_logger().info(f"the pose published before is revoked: {reason}")

    def _publish_frames(self) -> None:
        result = self._last
        if not self._p.publish_tf:
            return
        if self._holds and result is not None and result.determined:
            now_ns = self.get_clock().now().nanoseconds
            frames = conversions.frame_transforms(result, self._p.part_frame, now_ns)
            prefix = self._p.frame_prefix
            self._frames.publish(TFMessage(transforms=[prefixed(f, prefix) for f in frames]))

    # --- diagnostics ---------------------------------------------------------------------------

    def _image_health(self) -> Health:
        trouble = [subscription.trouble for subscription in self._inputs if subscription.trouble]
        return image_health(
            self._last,
            bad_poses=self._bad_poses,
            missed_images=self._missed_images,
            trouble=[*trouble, *self._silence()] if self._last is not None else [],
        )

    def _silence(self) -> list[str]:
        """Return why nothing can come of it at the moment."""
        if not self._active:
            return [keyed("said.not_active", "not active: images are not taken")]
        names = [self.resolve_topic_name(topic) for topic in (topics.IMAGE, topics.SPINDLE_POSE)]
        silent = [name for name in names if self.count_publishers(name) == 0]
        if silent:
            return [keyed("said.no_publisher", "nobody publishes {topics}", topics=listed(silent))]
        silent_s = time.monotonic() - self._pose_heard_s
        if silent_s > _SILENT_S:
            return [keyed("said.no_pose", "no spindle pose for {s} s", s=f"{silent_s:.0f}")]
        return []

    def _estimate_health(self) -> Health:
        return estimate_health(self._last, self._preparing)


def _load_kernels() -> None:
    warm_up_detection()
    warm_up_estimation()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    # One thread: in rclpy's pool, images waited up to a second behind the poses.
    return run_node(EstimatorNode, args, parameters=Parameters, threads=1, niceness=5)
