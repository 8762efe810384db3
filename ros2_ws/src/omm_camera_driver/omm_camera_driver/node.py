"""The camera node: wiring between the worker, which talks to the camera, and ROS."""

import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, TimeoutError
from functools import partial
from typing import Any

from omm_interfaces.srv import TriggerImage
from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty

from omm_camera_driver import camera_info
from omm_camera_driver.driver import Camera, Frame
from omm_camera_driver.drivers.choosing import DRIVERS
from omm_camera_driver.drivers.simulated.true_pose_listener import TruePoseListener
from omm_camera_driver.drivers.simulated.true_poses import TruePoses
from omm_camera_driver.health import connection_health
from omm_camera_driver.parameters import Parameters, camera_settings, check_exposure
from omm_camera_driver.worker import CameraWorker
from omm_core.errors import DeviceError, InputError, OmmError
from omm_core.words import keyed
from omm_ros import qos, topics
from omm_ros.conversions import image_message, time_from_ns
from omm_ros.diagnostics import WARN, Diagnostics, Health
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, watch
from omm_ros.published import CountingLifecycleNode


class CameraNode(CountingLifecycleNode):
    """Publishes /camera/image_raw and /camera/camera_info; takes images when asked."""

    def __init__(self) -> None:
        super().__init__("camera")
        self.failure: OmmError | None = None
        self._wanted = declare(self, Parameters)
        watch(self, self._wanted, self._on_parameters)
        self._worker: CameraWorker | None = None
        self._listener: TruePoseListener | None = None
        self._ended = threading.Event()
        self.context.on_shutdown(self._ended.set)
        self._diagnostics = Diagnostics(self)
        self._diagnostics.add("connection", self._health)

    # --- lifecycle ---

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the calibration and prepare the driver; the camera itself is not touched yet."""
        try:
            check_exposure(self._wanted)
            self._info = self._camera_info()
            self._poses = TruePoses()
            make_driver = DRIVERS[self._wanted.driver](self._wanted, self._poses)
            settings = camera_settings(self._wanted)
        except OmmError as error:
            self.failure = error
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._worker = CameraWorker(
            make_driver, settings, self, trigger_timeout_s=self._wanted.trigger_timeout_s
        )
        self._make_interfaces()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to connect; images come as soon as the camera is there."""
        result = super().on_activate(state)
        if self._worker is not None:
            self._worker.start()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release the camera."""
        self._stop_worker()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo `on_configure`."""
        self._stop_worker()
        self._worker = None
        for destroy in self._undo:
            destroy()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release the camera, whatever state it is in."""
        self._stop_worker()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Release the camera before the publishers are destroyed."""
        self._ended.set()
        self._stop_worker()
        self._stop_listening()
        super().destroy_node()

    # --- what the worker says, on its thread ---

    def on_frame(self, frame: Frame) -> None:
        """Publish an image and its camera_info."""
        frame_id = self._wanted.frame_prefix + self._wanted.frame_id
        image = image_message(frame.image, frame.exposure_mid_ns, frame_id)
        self._while_ros_runs(lambda: self._images.publish(image))
        self._while_ros_runs(lambda: self._infos.publish(self._info_for(frame, image)))

    def on_connected(self, camera: Camera) -> None:
        """Tell once who it is and what it granted."""
        self._diagnostics.hardware_id = camera.serial
        granted = ", ".join(f"{name} {value}" for name, value in camera.granted.items())
        text = f"Connected: {camera}" + (f" ({granted})" if granted else "")
        self._while_ros_runs(lambda: self.get_logger().info(text))
        for note in camera.notes:
            self._while_ros_runs(partial(self._warn, note))
        self._while_ros_runs(self._diagnostics.publish)

    def on_problem(self, problem: str) -> None:
        """Tell once what is wrong; the diagnostics go on telling it."""
        self._while_ros_runs(partial(self._warn, problem))
        self._while_ros_runs(self._diagnostics.publish)

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)

    def _while_ros_runs(self, say: Callable[[], object]) -> None:
        """Publish or log, unless Ctrl-C has ended ROS beneath the worker."""
        try:
            if self.context.ok():
                say()
        except RCLError:
            if self.context.ok():
                raise

    # --- what ROS asks ---

    def _trigger(
        self, request: TriggerImage.Request, response: TriggerImage.Response
    ) -> TriggerImage.Response:
        try:
            if self._worker is None:
                raise DeviceError("The camera node is not active. Activate it first.")
            stamp = self._wait(self._worker.request_image(), self._wanted.trigger_timeout_s + 1)
        except DeviceError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.stamp = True, time_from_ns(stamp)
        return response

    def _wait(self, future: "Future[int]", timeout_s: float) -> int:
        """Return the result; raise an error when the node ends or the device blocks."""
        for _ in range(round(timeout_s / 0.2)):
            try:
                return future.result(timeout=0.2)
            except TimeoutError:
                if self._ended.is_set():
                    break
        raise DeviceError("Expected an image, but the camera did not answer in time.")

    def _on_take_image(self, message: Empty) -> None:
        if self._worker is not None:
            self._worker.request_image().add_done_callback(self._tell_failure)

    def _tell_failure(self, future: "Future[int]") -> None:
        if future.exception() is not None:
            self.get_logger().warning(f"{future.exception()}", throttle_duration_sec=1.0)

    def _on_parameters(self, updated: Parameters) -> None:
        before, after = camera_settings(self._wanted), camera_settings(updated)
        for name in ("exposure_us", "gain"):
            value = getattr(after, name)
            if value is not None and value != getattr(before, name) and self._worker is not None:
                self._change(self._worker, name, value)
        self._wanted = updated

    def _change(self, worker: CameraWorker, name: str, value: float) -> None:
        try:
            granted = worker.change(name, value).result(timeout=1.0)
        except TimeoutError:
            self.get_logger().warning(f"{name} is set as soon as the camera answers again.")
        except DeviceError as error:
            raise InputError(str(error)) from error
        else:
            self.get_logger().info(f"{name}: asked for {value:g}, granted {granted:g}")

    def _on_set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        """Keep what ROS's camera_calibration has found, where camera_info is read from."""
        file, url = self._wanted.calibration_file, self._wanted.camera_info_url
        try:
            if file:
                raise InputError(
                    f"camera_info is made of {file}, which says more (where the camera sits in the "
                    "taper): calibrate with ./omm calibrate, and give the node the new file."
                )
            if not url:
                raise InputError("Expected the parameter camera_info_url: where to keep it.")
            self._info = camera_info.keep(url, request.camera_info)
        except InputError as error:
            response.success, response.status_message = False, str(error)
            return response
        response.success, response.status_message = True, f"kept in {url}"
        self.get_logger().info(f"camera_info was set, and is {response.status_message}")
        return response

    # --- wiring ---

    def _make_interfaces(self) -> None:
        self._images = self.create_lifecycle_publisher(Image, topics.IMAGE, qos.IMAGE)
        self._infos = self.create_lifecycle_publisher(CameraInfo, topics.CAMERA_INFO, qos.IMAGE)
        # One trigger waits for its image while everything else goes on being answered.
        group = MutuallyExclusiveCallbackGroup()
        service = self.create_service(
            TriggerImage, "~/trigger", self._trigger, callback_group=group
        )
        setting = self.create_service(
            SetCameraInfo, topics.SET_CAMERA_INFO, self._on_set_camera_info
        )
        asked = self.create_subscription(Empty, "~/take_image", self._on_take_image, qos.STATE)
        self._undo: list[Callable[[], Any]] = [
            partial(self.destroy_publisher, self._images),
            partial(self.destroy_publisher, self._infos),
            partial(self.destroy_service, service),
            partial(self.destroy_service, setting),
            partial(self.destroy_subscription, asked),
        ]
        if self._wanted.driver == "simulated":
            self._listener = TruePoseListener(self, self._poses.add, self._poses.move_part)
            self._undo.append(self._stop_listening)

    def _camera_info(self) -> camera_info.InfoSource:
        file, url = self._wanted.calibration_file, self._wanted.camera_info_url
        if file and url:
            raise InputError("Expected calibration_file or camera_info_url, got both.")
        if not file and not url:
            return camera_info.uncalibrated()
        info = camera_info.from_calibration(file) if file else camera_info.from_url(url)
        self.get_logger().info(
            f"camera_info is plumb_bob, off the calibration by {info.largest_error_px:.2g} px "
            "at most over the image."
        )
        return info

    def _info_for(self, frame: Frame, image: Image) -> CameraInfo:
        height, width = frame.image.shape
        calibrated = self._info.message
        info = camera_info.for_image(calibrated, (width, height), self._region())
        info.header = image.header
        if calibrated.k[0] and not info.k[0]:
            self.get_logger().warning(
                f"camera_info goes out without a calibration: the images have {width} × {height} "
                f"pixels, the calibration is of {calibrated.width} × {calibrated.height}.",
                once=True,
            )
        return info

    def _region(self) -> tuple[int, int] | None:
        """Return the corner of the region of interest; None where none was asked for."""
        wanted = self._wanted
        corner = wanted.roi_x_px, wanted.roi_y_px
        is_asked_for = any((*corner, wanted.roi_width_px, wanted.roi_height_px))
        # A V4L2 device scales its images to a size; it does not cut.
        return corner if is_asked_for and wanted.driver != "v4l2" else None

    def _stop_worker(self) -> None:
        if self._worker is None or self._worker.stop(timeout_s=1.0):
            return
        if self.context.ok():
            self.get_logger().warning("The camera still blocks; it is left to end by itself.")

    def _stop_listening(self) -> None:
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _health(self) -> Health:
        if self._worker is None:
            return Health(level=WARN, message=keyed("said.not_configured", "not configured"))
        status = self._worker.status()
        return connection_health(status, self._listener.failure if self._listener else "")


def main(args: list[str] | None = None) -> None:
    """Run the camera node."""
    sys.exit(run_node(CameraNode, args, parameters=Parameters, threads=3))
