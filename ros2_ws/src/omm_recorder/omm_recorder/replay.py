"""Publishes a recording as it was: same bytes, same stamps, same order, and /clock."""

import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from omm_core.errors import InputError
from omm_recorder import keyboard
from omm_recorder.conversions import as_installed, message_class, profile_from_qos
from omm_recorder.definitions import definition, fields_of
from omm_recorder.keyboard import Keyboard
from omm_recorder.playback import MAX_RATE, MIN_RATE, PlaybackClock
from omm_recorder.reading_ahead import read_ahead
from omm_recording.reading import RecordedMessage, Recording
from omm_recording.rosbag2_format import TopicQos, parsed_qos
from omm_ros import node_help
from omm_ros.conversions import time_from_ns
from omm_ros.environment import check_environment
from omm_ros.parameters import declare, network_parameter, parameter
from omm_ros.published import CountingNode

CLOCK_PERIOD_S = 0.025
KEY_PERIOD_S = 0.02
SETTLED_S = 1.0
_NEEDED = ("/image_raw", "/spindle_pose")
# What the live nodes publish themselves.
_OF_THE_NODES = ("/omm/", "/tf", "/rosout", "/parameter_events", "/diagnostics", "/clock")
_MIN_DEPTH = {"sensor_msgs/msg/Image": 10}


@dataclass(frozen=True, kw_only=True)
class ReplayParameters:
    """What to replay and how."""

    run: str = parameter("", "The recording: an MCAP file or a run's folder.")
    rate: float = parameter(
        1.0, "How many times faster than recorded.", minimum=MIN_RATE, maximum=MAX_RATE
    )
    loop: bool = parameter(False, "Start again at the end.")
    start_s: float = parameter(0.0, "Seconds from the beginning to start at.", minimum=0.0)
    pause: bool = parameter(False, "Start paused.")
    topics: tuple[str, ...] = parameter(
        (), "Topics to publish; none named: what cameras and controls published."
    )
    all_topics: bool = parameter(False, "Publish every recorded topic.")
    clock: bool = parameter(True, "Publish /clock.")
    wait_s: float = parameter(
        5.0, "Wait this long for listeners to images and poses before the start.", minimum=0.0
    )
    network: bool = network_parameter()


class ReplayNode(CountingNode):
    """Publishes a recording.

    Raises
    ------
    InputError
        If there is no such recording, it has no such topic, or a message type is not installed.
    """

    def __init__(
        self, overrides: list[Parameter] | None = None, ended: threading.Event | None = None
    ) -> None:
        super().__init__("replay", parameter_overrides=overrides or [])
        self.parameters = declare(self, ReplayParameters)
        if not self.parameters.run:
            raise InputError("Expected the parameter run: the recording to replay.")
        self.recording = Recording(Path(self.parameters.run))
        self.topics = self._chosen()
        self._changed = self._changed_types()
        self.sent = 0
        self._ended = ended or threading.Event()
        self._playing: dict[str, Publisher] = {name: self._publisher(name) for name in self.topics}
        self._clock = self.create_publisher(Clock, "/clock", 10)
        self._clock_ns = 0
        self.first_ns, self.last_ns = self._range()

    def end(self) -> None:
        """Stop playing soon."""
        self._ended.set()

    def play(self) -> None:
        """Publish the whole recording; returns at its end, or after `end`."""
        with Keyboard() as keys:
            self._wait_for_listeners()
            if keys.present:
                print("space: pause  →: one message  ↑ ↓: faster, slower", file=sys.stderr)
            while not self._ended.is_set():
                self._play_once(keys)
                if not self.parameters.loop:
                    break
            self._show(keys, self.last_ns, 0.0, end="\n")

    def _play_once(self, keys: Keyboard) -> None:
        start_ns = self.first_ns + int(self.parameters.start_s * 1e9)
        clock = PlaybackClock(start_ns, rate=self.parameters.rate, paused=self.parameters.pause)
        self._clock_ns = 0
        for message in read_ahead(
            self.recording.messages(self.topics, start_ns=start_ns), self._ended
        ):
            if not self._wait_for(message, clock, keys):
                return
            self._tell_time(max(message.log_time_ns, self._clock_ns))
            self._playing[message.topic].publish(self._as_published(message))
            self.sent += 1
            clock.played(message.log_time_ns)
        if not self._ended.is_set():
            self._wait_until_taken()

    def _as_published(self, message: RecordedMessage) -> Any:
        """Return the recorded bytes; of a type that has changed since, a message of today's."""
        changed = self._changed.get(message.topic)
        if changed is None:
            return bytes(message.data)
        return as_installed(changed, self.recording.decode(message))

    def _changed_types(self) -> dict[str, Any]:
        """Return by topic the types whose fields are others today than when it was recorded."""
        changed = {}
        for name in self.topics:
            topic = self.recording.topics[name]
            # ROS's own types keep theirs.
            if not (topic.type_name.startswith("omm_interfaces/") and topic.definition):
                continue
            if fields_of(topic.definition) != fields_of(definition(topic.type_name)):
                changed[name] = message_class(topic.type_name)
        return changed

    def _wait_for(self, message: RecordedMessage, clock: PlaybackClock, keys: Keyboard) -> bool:
        """Wait for the time; return False where the replay is to end."""
        shown_s = 0.0
        while not self._ended.is_set():
            wait_s = clock.wait_s(message.log_time_ns)
            if wait_s == 0.0:
                return True
            if not clock.paused:
                self._tell_time(clock.now_ns())
            now_s = time.monotonic()
            if now_s - shown_s > 0.1:
                self._show(keys, clock.now_ns(), clock.rate, paused=clock.paused)
                shown_s = now_s
            key = keys.key(min(KEY_PERIOD_S, KEY_PERIOD_S if wait_s is None else wait_s))
            _press(key, clock)
        return False

    def _tell_time(self, time_ns: int) -> None:
        """Publish /clock: with each message, and in between."""
        if self.parameters.clock and (
            time_ns >= self._clock_ns + CLOCK_PERIOD_S * 1e9 or self._clock_ns == 0
        ):
            self._clock_ns = time_ns
            self._clock.publish(Clock(clock=time_from_ns(time_ns)))

    def _show(
        self, keys: Keyboard, time_ns: int, rate: float, *, paused: bool = False, end: str = ""
    ) -> None:
        if not keys.present:
            return
        at, total = (time_ns - self.first_ns) / 1e9, (self.last_ns - self.first_ns) / 1e9
        state = "paused" if paused else f"x{rate:.2f}" if rate else "end"
        print(f"\r\033[K{at:8.2f} of {total:.2f} s  {state}", end=end, file=sys.stderr, flush=True)

    def _chosen(self) -> tuple[str, ...]:
        there = self.recording.topics
        if self.parameters.topics:
            for name in self.parameters.topics:
                if name not in there:
                    raise InputError(
                        f"Expected {name} in the recording; it holds {', '.join(sorted(there))}."
                    )
            return self.parameters.topics
        chosen = tuple(
            name
            for name, topic in there.items()
            if topic.messages != 0
            and (self.parameters.all_topics or not name.startswith(_OF_THE_NODES))
        )
        if not chosen:
            raise InputError(f"Expected messages in {self.parameters.run}, found none to play.")
        return chosen

    def _publisher(self, name: str) -> Publisher:
        topic = self.recording.topics[name]
        qos = parsed_qos(topic.metadata.get("offered_qos_profiles", ""))
        depth = max(qos.depth, _MIN_DEPTH.get(topic.type_name, 1000))
        # Reliable in any case: a recording is complete, and its replay shall be.
        profile = profile_from_qos(TopicQos(reliable=True, latched=qos.latched, depth=depth))
        return self.create_publisher(message_class(topic.type_name), name, profile)

    def _range(self) -> tuple[int, int]:
        blocks = [b for file in self.recording.files for b in file.blocks(self.topics)]
        return min(b.first_ns for b in blocks), max(b.last_ns for b in blocks)

    def _wait_for_listeners(self) -> None:
        """Wait until everybody is connected, so that nobody misses the first messages.

        Listeners are announced to us one by one: it is waited until there is one to the images and
        one to the poses, all that are known are connected, and for a while no other comes.
        """
        needed = [p for n, p in self._playing.items() if n.endswith(_NEEDED)]
        until_s = time.monotonic() + self.parameters.wait_s
        before: list[int] = []
        since_s = time.monotonic()
        while not self._ended.is_set() and time.monotonic() < until_s:
            connected = [p.get_subscription_count() for p in self._playing.values()]
            known = [self.count_subscribers(name) for name in self._playing]
            complete = connected == known and all(p.get_subscription_count() for p in needed)
            if connected != before or not complete:
                before, since_s = connected, time.monotonic()
            elif time.monotonic() - since_s > SETTLED_S:
                return
            time.sleep(0.02)
        if not self._ended.is_set() and self.parameters.wait_s > 0:
            self.get_logger().warning("Not everything that is replayed has a listener.")

    def _wait_until_taken(self) -> None:
        from rclpy.duration import Duration

        for publisher in self._playing.values():
            publisher.wait_for_all_acked(Duration(seconds=2.0))


def _press(key: str | None, clock: PlaybackClock) -> None:
    actions = {
        keyboard.SPACE: clock.toggle_pause,
        keyboard.RIGHT: clock.step,
        keyboard.UP: lambda: clock.change_rate(1.1),
        keyboard.DOWN: lambda: clock.change_rate(1.0 / 1.1),
    }
    if key in actions:
        actions[key]()


def replay(overrides: list[Parameter] | None = None, arguments: list[str] | None = None) -> int:
    """Play a recording from beginning to end.

    Raises
    ------
    InputError
        As `ReplayNode` does.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from omm_ros import transport
    from omm_ros.interrupt import told_to_end

    transport.prepare(arguments)
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = None
    spinning = None
    executor = SingleThreadedExecutor()
    try:
        with told_to_end(for_good=True) as ended:
            node = ReplayNode(overrides, ended)
            executor.add_node(node)
            spinning = threading.Thread(target=executor.spin, name="spinning", daemon=True)
            spinning.start()
            node.play()
        return 0
    except KeyboardInterrupt:
        return 0
    finally:
        if node is not None:
            node.end()
        executor.shutdown(timeout_sec=1.0)
        if spinning is not None:
            spinning.join(2.0)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def main(args: list[str] | None = None) -> int:
    """Run the replay node; status 2 where its parameters cannot be used."""
    if node_help.asked(args):
        print(node_help.help_text(ReplayNode.__doc__ or "", ReplayParameters), end="")
        return 0
    try:
        check_environment()
        return replay(arguments=args)
    except InputError as error:
        print(f"omm: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
