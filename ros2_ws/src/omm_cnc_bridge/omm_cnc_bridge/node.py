"""The node ``cnc_bridge``: wiring between a control and ROS.

One thread reads the control and publishes; the executor's threads answer services and timers.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from omm_interfaces.msg import SpindleState
from omm_interfaces.srv import TriggerImage
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from tf2_msgs.msg import TFMessage

from omm_cnc_bridge import conversions
from omm_cnc_bridge.camera_watch import CameraWatch
from omm_cnc_bridge.commands import Commands
from omm_cnc_bridge.control import (
    Connection,
    ControlSample,
    KeepsTime,
    KnowsTruth,
    ProgramState,
    SamplesAtIntervals,
)
from omm_cnc_bridge.controls.choosing import make_control
from omm_cnc_bridge.handshake import Acknowledge, Action, Trigger
from omm_cnc_bridge.judgement import JudgedSample
from omm_cnc_bridge.leading import Leading
from omm_cnc_bridge.making import make_handshake, make_judge
from omm_cnc_bridge.parameters import Parameters
from omm_cnc_bridge.refusal_log import RefusalLog
from omm_core.errors import DeviceError
from omm_core.words import NOTHING, Words, keyed, of_error, sentences
from omm_ros import qos, topics
from omm_ros.conversions import stamp_ns
from omm_ros.diagnostics import ERROR, FINE, OK, WARN, Diagnostics, Health
from omm_ros.frames import prefixed
from omm_ros.node_main import run_node
from omm_ros.parameters import declare
from omm_ros.published import CountingNode

_NOT_YET = keyed("said.not_connected_yet", "not connected yet")
_BUSY = {
    ProgramState.RUNNING: keyed("said.program_running", "program running"),
    ProgramState.WAITING: keyed("said.program_waiting", "program waiting"),
    ProgramState.INTERRUPTED: keyed("said.program_interrupted", "program interrupted"),
}
TF_RATE_HZ = 30.0
END_PATIENCE_S = 1.0  # for a connection that is just being made; it is given up with the process


class CncBridgeNode(CountingNode):
    """Publishes true spindle poses of a control, and has images taken where its program asks."""

    def __init__(self) -> None:
        super().__init__("cnc_bridge")
        self._p = p = declare(self, Parameters)
        self._control, machine = make_control(p)
        self._judge = make_judge(p, machine)
        self._leading = Leading(self, self._control, p, machine)
        self._handshake = make_handshake(p, self._leading)
        self._attempt_told: Words = NOTHING
        self._lock = threading.Lock()  # around the handshake
        self._connection, self._detail = Connection.DISCONNECTED, _NOT_YET
        self._judged: JudgedSample | None = None
        self._heard_s = 0.0
        self._state_due_s = self._tf_due_s = 0.0
        self._ages_ns: deque[int] = deque(maxlen=1000)
        self._failure: Exception | None = None
        self._notes: set[str] = set()
        self._refusals = RefusalLog()

        self._pose = self.create_publisher(PoseStamped, topics.SPINDLE_POSE, qos.POSE)
        self._state = self.create_publisher(SpindleState, topics.SPINDLE_STATE, qos.STATE)
        self._tf = self.create_publisher(TFMessage, topics.TF, qos.STATE)
        self._truth = (
            self.create_publisher(PoseStamped, topics.TRUE_SPINDLE_POSE, qos.POSE)
            if p.publish_truth and isinstance(self._control, KnowsTruth)
            else None
        )
        group = ReentrantCallbackGroup()
        self._camera = (
            self.create_client(TriggerImage, p.trigger_service, callback_group=group)
            if p.trigger_service
            else None
        )
        self._watch = CameraWatch(self, self._camera) if self._camera and p.start_program else None
        self._awaited = ""
        self._commands = Commands(self, self._control, p, self._trouble, self._unrest)
        self.create_timer(1.0 / p.state_rate_hz, self._on_timer)
        diagnostics = Diagnostics(self, hardware_id=p.control)
        diagnostics.add("connection", self._connection_health)
        diagnostics.add("poses", self._pose_health)
        diagnostics.add("images", self._image_health)

        if introduction := self._commands.introduction():
            self.get_logger().info(introduction)
        self._stopping = threading.Event()
        self._reader = threading.Thread(target=self._run, name="control reader", daemon=True)
        self._reader.start()

    def destroy_node(self) -> None:
        """Stop reading, disconnect, and end the node."""
        self._stopping.set()
        self._reader.join(timeout=END_PATIENCE_S)
        super().destroy_node()

    # --- the reading thread --------------------------------------------------------------------

    def _run(self) -> None:
        """Read until the end; what goes wrong unforeseen ends the node."""
        try:
            while self._is_wanted():
                self._run_connection()
                self._stopping.wait(self._p.reconnect_s)
        except Exception as error:  # the timer raises it in the main thread
            if self.context.ok():
                self._failure = error

    def _is_wanted(self) -> bool:
        """Return whether to go on: Ctrl-C ends the context first, and then the node."""
        return self.context.ok() and not self._stopping.is_set()

    def _run_connection(self) -> None:
        """Connect, and read until the connection is lost."""
        try:
            self._set_connection(Connection.CONNECTING, conversions.NO_SAMPLE)
            self._control.connect()
            self._leading.connected()
            while self._is_wanted():
                self._read()
        except DeviceError as error:
            self._lost(error)
        finally:
            self._control.close()

    def _read(self) -> None:
        samples = self._control.read(0.05)
        for sample in samples:
            self._take(sample)
        if self._truth is not None and isinstance(self._control, KnowsTruth):
            for pose in self._control.read_truth():
                truth = conversions.pose_message(pose.stamp_ns, pose.machine_T_spindle)
                self._truth.publish(prefixed(truth, self._p.frame_prefix))

    def _take(self, sample: ControlSample) -> None:
        """Judge one sample, publish what it is good for, and serve the program."""
        now_ns = time.time_ns()
        judged = self._judge.judge(sample, now_ns)
        if judged.machine_T_spindle is not None:
            self._publish_pose(judged)
        self._tell(judged)
        if sample.stamp_ns > now_ns - round(self._p.stale_after_s * 1e9):
            self._heard_s = time.monotonic()
            self._set_connection(Connection.CONNECTED, NOTHING)
        self._leading.heard(sample)
        with self._lock:
            action = self._handshake.sample(sample, judged.rest_since_ns, now_ns)
            trouble, status = self._handshake.trouble, self._handshake.status
        if trouble and trouble != self._attempt_told:
            self.get_logger().warning(f"image {self._handshake.request}: {status}")
        self._attempt_told = trouble
        changed = self._judged is None or _noteworthy(self._judged) != _noteworthy(judged)
        self._judged = judged
        if changed or action is not None:
            self._publish_state()
        self._act(action)

    def _tell(self, judged: JudgedSample) -> None:
        """Log what was chosen, and refusals that go on: not everyone reads diagnostics."""
        for note in judged.sample.notes:
            if note not in self._notes:
                self._notes.add(note)
                log = self.get_logger()
                (log.warning if "NOT ENCRYPTED" in note else log.info)(note)
        words = self._refusals.hear(judged.refused, time.monotonic())
        if words:
            self.get_logger().warning(words)

    def _publish_pose(self, judged: JudgedSample) -> None:
        pose, stamp = judged.machine_T_spindle, judged.sample.stamp_ns
        assert pose is not None
        prefix = self._p.frame_prefix
        self._pose.publish(prefixed(conversions.pose_message(stamp, pose), prefix))
        self._ages_ns.append(judged.age_ns)
        if self._p.publish_tf and time.monotonic() >= self._tf_due_s:
            self._tf_due_s = time.monotonic() + 1.0 / TF_RATE_HZ
            transform = prefixed(conversions.spindle_transform(stamp, pose), prefix)
            self._tf.publish(TFMessage(transforms=[transform]))

    # --- the handshake -------------------------------------------------------------------------

    def _act(self, action: Action) -> None:
        if isinstance(action, Trigger):
            self._trigger(action)
        elif isinstance(action, Acknowledge):
            try:
                judged = self._judged
                pose = judged.machine_T_spindle if judged is not None else None
                self._leading.before_answer(action, pose)
                self._control.acknowledge(action.request)
            except DeviceError as error:
                self.get_logger().error(f"image {action.request} is not acknowledged: {error}")
                with self._lock:
                    self._handshake.refused(str(error), time.time_ns())

    def _trigger(self, action: Trigger) -> None:
        if self._camera is None:
            return
        if not self._camera.service_is_ready():
            self._answer(action, None, f"there is no service {self._camera.service_name}")
            return
        future = self._camera.call_async(TriggerImage.Request())
        future.add_done_callback(lambda done: self._on_image(action, done))

    def _on_image(self, action: Trigger, future: Future) -> None:
        response = future.result()
        if response is None or not response.success:
            self._answer(action, None, response.message if response else "no answer")
        else:
            self._answer(action, stamp_ns(response.stamp), "")

    def _answer(self, action: Trigger, image_ns: int | None, message: str) -> None:
        with self._lock:
            self._handshake.image(action.attempt, image_ns, message, time.time_ns())

    # --- state ---------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        if self._failure is not None:
            raise self._failure
        silent_s = time.monotonic() - self._heard_s
        if self._connection is Connection.CONNECTED and silent_s > self._p.stale_after_s:
            self._set_connection(
                Connection.STALE, keyed("said.control_quiet", "the control says nothing new")
            )
        if time.monotonic() >= self._state_due_s:
            self._publish_state()
        wanted = self._commands.is_simulated and self._p.start_program
        if wanted and not (self._commands.started or self._trouble()):
            self._start_when_the_camera_is_there()

    def _start_when_the_camera_is_there(self) -> None:
        if self._watch is None:
            return
        if awaited := self._watch.awaited():
            if awaited != self._awaited:
                self.get_logger().info(f"the program waits for {awaited}")
            self._awaited = awaited
            return
        started, why = self._commands.start_program()
        if not started:
            self.get_logger().warning(
                f"the program is not started: {why}", throttle_duration_sec=10.0
            )

    def _publish_state(self) -> None:
        self._state_due_s = time.monotonic() + 0.9 / self._p.state_rate_hz
        message = conversions.state_message(
            self._p.control, self._connection, self._detail, self._judged, self._judge.machine
        )
        message.measure_acknowledged = self._handshake.acknowledged
        self._state.publish(prefixed(message, self._p.frame_prefix))

    def _set_connection(self, connection: Connection, detail: Words) -> None:
        changed = connection is not self._connection
        self._connection, self._detail = connection, detail
        if changed:
            words = f"{self._p.control}: {connection.name.lower()}{': ' if detail else ''}{detail}"
            # One line each: rclpy lets a line log in one severity only.
            if connection in (Connection.STALE, Connection.DISCONNECTED):
                self.get_logger().warning(words)
            else:
                self.get_logger().info(words)
            self._publish_state()

    def _lost(self, error: DeviceError) -> None:
        self._judge.forget()
        with self._lock:
            self._handshake = make_handshake(self._p, self._leading, self._handshake.acknowledged)
        self._set_connection(
            Connection.DISCONNECTED,
            keyed("said.trying_again", "{why} Trying again.", why=of_error(error)),
        )

    def _trouble(self) -> Words:
        """Return why the control is not connected; empty where it is."""
        return NOTHING if self._connection is Connection.CONNECTED else self._detail

    def _unrest(self) -> Words:
        """Return why the machine is not at rest without a program; empty where it is."""
        judged = self._judged
        if judged is None:
            return conversions.NO_SAMPLE
        state = judged.sample.program_state
        return _BUSY.get(state, judged.moving_reason)

    # --- diagnostics ---------------------------------------------------------------------------

    def _connection_health(self) -> Health:
        values = {"connection": self._connection.name, **self._clock_values()}
        if self._connection is not Connection.CONNECTED:
            return Health(level=ERROR, message=self._detail, values=values)
        interval_s = 0.0
        if isinstance(self._control, SamplesAtIntervals):
            interval_s = self._control.revised_interval_s or 0.0
        if interval_s > self._p.gap_s / 1.5:
            message = keyed(
                "said.slow_server",
                "the server gives a sample every {s} s only; raise gap_s",
                s=f"{interval_s:.3f}",
            )
            return Health(level=WARN, message=message, values=values)
        return Health(level=OK, message=FINE, values=values)

    def _clock_values(self) -> dict[str, object]:
        clock = self._control.clock if isinstance(self._control, KeepsTime) else None
        if clock is None or clock.relation is None:
            return {}
        return {
            "clock offset [ms]": f"{clock.relation.offset_ns / 1e6:.3f}",
            "clock drift [ppm]": f"{clock.relation.drift * 1e6:.1f}",
            "clock uncertainty [ms]": f"{clock.relation.uncertainty_ns / 1e6:.3f}",
            "clock jumps": clock.jumps,
        }

    def _pose_health(self) -> Health:
        judged, refusals = self._judged, Counter(self._judge.refusals)
        ages = sorted(self._ages_ns.copy())
        values: dict[str, object] = {f"refused: {why}": n for why, n in refusals.items()}
        if ages:
            values["age p50 [ms]"] = f"{ages[len(ages) // 2] / 1e6:.2f}"
            values["age p99 [ms]"] = f"{ages[len(ages) * 99 // 100] / 1e6:.2f}"
        if judged is None:
            return Health(level=WARN, message=conversions.NO_SAMPLE, values=values)
        if self._connection is not Connection.CONNECTED:
            return Health(level=ERROR, message=f"no poses: {self._detail}", values=values)
        limits = self._judge.machine.out_of_limits(judged.axes)
        message = judged.refused or sentences(limits) or FINE
        return Health(
            level=WARN if judged.refused or limits else OK, message=message, values=values
        )

    def _image_health(self) -> Health:
        with self._lock:
            status, trouble = self._handshake.status, self._handshake.trouble
            values = {"last acknowledged": self._handshake.acknowledged}
        if trouble:
            return Health(level=ERROR, message=status, values=values)
        if self._camera is not None and not self._camera.service_is_ready():
            message = f"there is no service {self._camera.service_name}; {status}"
            return Health(level=WARN, message=message, values=values)
        return Health(level=OK, message=status, values=values)


def _noteworthy(judged: JudgedSample) -> tuple[object, ...]:
    """Return what is published at once when it changes."""
    s = judged.sample
    still = not judged.moving_reason
    refused = bool(judged.refused)
    return s.measure_request, still, s.program_state, s.mode, s.program, s.orientation, refused


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    make: Callable[[], Node] = CncBridgeNode
    return run_node(make, args, parameters=Parameters, threads=2)
