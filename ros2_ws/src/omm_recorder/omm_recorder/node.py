"""The recorder: everything that happens, in one file. Wiring only; see `recorder` for the work."""

import os
import sys
import time
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from omm_core.errors import InputError, OmmError
from omm_core.words import of_error
from omm_recorder.conversions import message_class, profile_from_qos, qos_from_profile
from omm_recorder.definitions import definition, type_hash
from omm_recorder.files import FileToRecord, file_to_record
from omm_recorder.health import recording_health
from omm_recorder.parameter_snapshot import ParameterSnapshot, as_table
from omm_recorder.parameters import Parameters
from omm_recorder.provenance import provenance
from omm_recorder.recorder import STOPPED, Recorder
from omm_recorder.recording_state import Limits
from omm_recorder.topics import KNOWN, adapted
from omm_recording.interrupted import interrupted, set_aside
from omm_recording.rosbag2_format import TopicQos
from omm_recording.writing import RUN_NAME, RecordingOptions, RecordingWriter, TopicToRecord
from omm_ros.diagnostics import Diagnostics, Health
from omm_ros.node_main import run_node
from omm_ros.parameters import declare
from omm_ros.published import NAME as PUBLISHED
from omm_ros.published import CountingNode, parsed
from omm_ros.topics import without_namespace

LOOK_PERIOD_S = 0.5
CHANGES = "/parameter_events"
DIAGNOSTICS = "/diagnostics"
END_PATIENCE_S = 2.5
FILES = {
    "part_file": "part.yaml",
    "calibration_file": "camera.yaml",
    "machine_file": "machine.yaml",
}
OWNER = "estimator"
"""The node whose parameters those are; no other's are believed."""


class RecorderNode(CountingNode):
    """Subscribes to all there is to record and hands the bytes to a `Recorder`.

    Raises
    ------
    InputError
        If it cannot record there, or a file to be recorded cannot be read.
    """

    def __init__(self) -> None:
        super().__init__("recorder")
        self.parameters = declare(self, Parameters)
        self.failed = False
        self._attached: dict[str, bytes] = {}
        self._unread: dict[str, str] = {}  # files that a node uses and we cannot read
        self._heard: dict[str, tuple[TopicQos, Subscription]] = {}
        self._heard_as: dict[str, str] = {}  # recorded name -> name with the namespace
        self._unknown: set[str] = set()
        self._owners: set[str] = set()
        self._tellers: set[str] = set()
        files = self._files_to_attach()
        self.recorder = self._started()
        try:
            self._listen_to_all(files)
        except BaseException:
            self.recorder.stop()
            raise
        self.get_logger().info(f"Recording to {self.folder}")

    def _listen_to_all(self, files: dict[str, FileToRecord]) -> None:
        for name, file in files.items():
            self._attach(name, file)
        for topic in KNOWN:
            self._listen(topic.heard_as, topic.type_name, topic.qos, shared=topic.shared)
        self._snapshot = ParameterSnapshot(self, self._take_parameters)
        self._looking = self.create_timer(LOOK_PERIOD_S, self._look)
        diagnostics = Diagnostics(self)
        diagnostics.add("recording", self._health)

    def destroy_node(self) -> None:
        """End the recording, then the node."""
        try:
            unknown = self._ask_for_ends()
        finally:
            self._end()
        if unknown:
            print(
                f"recorder: not known whether the last messages came: {', '.join(unknown)} "
                "(the publisher had ended, or is none of omm's)",
                file=sys.stderr,
            )
        super().destroy_node()

    def _ask_for_ends(self) -> list[str]:
        """Wait until the publishers have told how many messages there were, and those are here.

        They tell it once a second; who has gone or never told is not waited for. Returns the
        topics of which it is not known.
        """
        since_s = time.monotonic()
        self._drain()
        while time.monotonic() < since_s + END_PATIENCE_S and self.recorder.state().recording:
            if not any(self._may_answer(name) for name in self.recorder.waiting_for(since_s)):
                break
            time.sleep(0.02)
            self._drain()
        return self.recorder.count_ends(since_s)

    def _may_answer(self, topic: str) -> bool:
        """Return whether a publisher of a topic is there that has ever told its number."""
        heard = self._heard_as[topic]
        subscription = self._heard[heard][1]
        with subscription.handle:
            return heard in self._tellers and subscription.handle.get_publisher_count() > 0

    def _end(self) -> None:
        # Not through the log: it is published, and the context may be shut down already.
        try:
            path = self.recorder.stop()
        except OmmError as error:
            print(f"recorder: {error}", file=sys.stderr)
            self.failed = True
            return
        state = self.recorder.state()
        lost = state.lost + state.missing
        print(
            f"recorder: {path}, {state.received} messages, {state.bytes_written / 1e6:.1f} MB, "
            + (f"{lost} LOST" if lost else "none lost"),
            file=sys.stderr,
        )
        self.failed = state.ended_because != STOPPED

    def _drain(self) -> None:
        """Take what has arrived and waits; that works although the context is shut down."""
        for name, (qos, subscription) in self._heard.items():
            recorded = without_namespace(name, self.get_namespace())
            with subscription.handle:
                for _ in range(qos.depth):
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                    if taken is None:
                        break
                    self._take(recorded, *taken)

    def _started(self) -> Recorder:
        p = self.parameters
        self.folder = (
            Path(p.folder) if p.folder else Path("runs") / f"{datetime.now():%Y%m%d-%H%M%S}"
        )
        options = RecordingOptions(
            compression=p.compression,
            key_file=Path(p.key_file) if p.key_file else None,
            provenance=provenance(),
            distro=os.environ.get("ROS_DISTRO", "jazzy"),
        )
        limits = Limits(
            queue_bytes=p.queue_mb << 20,
            warn_left_s=p.warn_left_min * 60.0,
            stop_free_bytes=p.stop_free_mb << 20,
        )
        path = self.folder / RUN_NAME
        aside = set_aside(path)
        if aside is not None:
            self.get_logger().warning(
                f"{aside} is a recording that was interrupted: ./omm repair {aside}"
            )
        return Recorder(RecordingWriter(path, options), limits, self._tell)

    def _files_to_attach(self) -> dict[str, FileToRecord]:
        named = {n: getattr(self.parameters, p) for p, n in FILES.items()}
        return {name: file_to_record(Path(path), name) for name, path in named.items() if path}

    def _not_attached(self, name: str, error: InputError) -> None:
        self._unread[name] = of_error(error)
        self.get_logger().error(f"{error} The recording alone cannot be solved.")

    def _attach(self, name: str, file: FileToRecord) -> None:
        self._unread.pop(name, None)
        self._attached[name] = file.data
        self.recorder.add_file(name, file.data, file.mode)

    def _listen(self, name: str, type_name: str, qos: TopicQos, *, shared: bool = False) -> None:
        """Subscribe, or subscribe anew where the publishers offer something else.

        A recording is that of one machine: its namespace is no part of the recorded name.
        """
        name = self.resolve_topic_name(name)
        recorded = without_namespace(name, self.get_namespace())
        self._heard_as[recorded] = name
        if name in self._heard:
            self.destroy_subscription(self._heard[name][1])
        else:
            self.recorder.add_topic(
                TopicToRecord(
                    name=recorded,
                    type_name=type_name,
                    definition=definition(type_name),
                    type_hash=type_hash(type_name),
                    qos=qos,
                ),
                shared=shared,
            )
        subscription = self.create_subscription(
            message_class(type_name),
            name,
            partial(self._take, recorded),
            profile_from_qos(qos),
            raw=True,
        )
        self._heard[name] = (qos, subscription)

    def _take(self, topic: str, data: bytes, info: dict[str, Any]) -> None:
        received_ns = info["received_timestamp"] or time.time_ns()
        self.recorder.put(
            topic,
            data,
            info["publication_sequence_number"] or 0,
            received_ns,
            info["source_timestamp"] or received_ns,
        )
        if topic == DIAGNOSTICS:
            self._take_counts(deserialize_message(data, DiagnosticArray))
        if topic == CHANGES:
            self._take_changes(deserialize_message(data, ParameterEvent))

    def _take_counts(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not status.name.endswith(f": {PUBLISHED}"):
                continue
            for topic, count in parsed({v.key: v.value for v in status.values}).items():
                if topic in self._heard:
                    self._tellers.add(topic)
                    self.recorder.announce(without_namespace(topic, self.get_namespace()), count)

    def _look(self) -> None:
        """See what is new: topics to record, publishers to adapt to, nodes to ask."""
        wanted = {self.resolve_topic_name(name) for name in self.parameters.topics}
        for name, types in self.get_topic_names_and_types():
            if name not in self._heard and (self.parameters.all_topics or name in wanted):
                self._listen_new(name, types)
        for name, (qos, _) in list(self._heard.items()):
            self._adapt(name, qos)
        self._snapshot.look()

    def _listen_new(self, name: str, types: list[str]) -> None:
        if name in self._unknown:
            return
        try:
            if len(types) != 1:
                raise InputError(f"{name} has several types: {', '.join(types)}.")
            offers = self._offers(name)
            qos = adapted(TopicQos(depth=1000, latched=True), offers)
            self._listen(name, types[0], qos, shared=len(offers) > 1)
        except InputError as error:
            self._unknown.add(name)
            self.get_logger().error(f"{name} is not recorded. {error}")

    def _adapt(self, name: str, qos: TopicQos) -> None:
        offered = self._offers(name)
        fitting = adapted(qos, offered)
        if offered and fitting != qos:
            self.get_logger().info(f"{name}: adapting to its publishers' quality of service")
            self._listen(name, self._type_of(name), fitting)

    def _type_of(self, name: str) -> str:
        return str(self.get_publishers_info_by_topic(name)[0].topic_type)

    def _offers(self, name: str) -> list[TopicQos]:
        infos = self.get_publishers_info_by_topic(name)
        return [qos_from_profile(info.qos_profile, 1000) for info in infos]

    def _take_parameters(self, node: str, values: dict[str, Any]) -> None:
        """Keep a node's parameters, and the files that the estimator says it uses."""
        self.recorder.add_table(f"omm_parameters {node}", as_table(values))
        if not self._is_owner(node):
            return
        first = node not in self._owners
        self._owners.add(node)
        for parameter, name in FILES.items():
            path = values.get(parameter)
            # What this recorder was given itself counts until the estimator is given another.
            if isinstance(path, str) and path and not (first and name in self._attached):
                self._attach_changed(name, Path(path))

    def _attach_changed(self, name: str, path: Path) -> None:
        try:
            file = file_to_record(path, name)
        except InputError as error:
            self._not_attached(name, error)
            return
        if file.data != self._attached.get(name):
            self._attach(name, file)

    def _is_owner(self, node: str) -> bool:
        """Return whether it is this machine's estimator: another machine's part is not ours."""
        return node == f"{self.get_namespace().rstrip('/')}/{OWNER}"

    def _take_changes(self, event: ParameterEvent) -> None:
        """Ask the node itself: anybody can publish that its parameters changed."""
        if self._is_owner(event.node) and event.changed_parameters:
            self._snapshot.ask_again(event.node)

    def _tell(self, text: str) -> None:
        self.get_logger().error(text)

    def _health(self) -> Health:
        return recording_health(
            self.recorder.state(),
            self.folder / RUN_NAME,
            unread=list(self._unread.values()),
            attached=sorted(self._attached),
            unknown=sorted(self._unknown),
            interrupted=[str(path) for path in interrupted(self.folder)],
        )


def main(args: list[str] | None = None) -> int:
    """Run the recorder; status 1 where the recording did not end well."""
    made: list[RecorderNode] = []

    def make() -> RecorderNode:
        """Make the node that records a measurement's topics, its part and calibration files."""
        made.append(RecorderNode())
        return made[0]

    status = run_node(make, args, parameters=Parameters, threads=1)
    return status or int(bool(made) and made[0].failed)


if __name__ == "__main__":
    sys.exit(main())
