"""The recorder and the replay as processes, over the real middleware."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")

import rclpy
import rclpy.duration
import rclpy.executors
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterEvent, ParameterValue
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from omm_bringup.isolation import own_domain
from omm_recorder.conversions import message_class, profile_from_qos
from omm_recorder.definitions import definition, type_hash
from omm_recorder.topics import KNOWN
from omm_recording.inspecting import inspect
from omm_recording.reading import Recording
from omm_recording.repairing import repair, repaired_name
from omm_recording.rosbag2_format import TopicQos
from omm_recording.run_files import UNFINISHED
from omm_recording.verifying import verify
from omm_ros import transport
from omm_ros.diagnostics import Diagnostics
from omm_ros.environment import PROFILE_VARIABLES
from omm_ros.published import CountingLifecycleNode, CountingNode, published
from omm_runs.recorded_estimator import left_out, options_from
from omm_runs.solving import SolveRunOptions, solve_run

Process = "subprocess.Popen[str]"
POSES = "/cnc/spindle_pose"
IMAGES = "/camera/image_raw"


@pytest.fixture(scope="module")
def domain() -> Iterator[None]:
    before = dict(os.environ)
    transport.prepare()
    with own_domain():
        yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture
def node(domain: None) -> Iterator[Any]:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("tester", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.fixture
def start(domain: None, python_environment: dict[str, str]) -> Iterator[Callable[..., Any]]:
    """Start a node of the recorder with parameters; what a test leaves running is ended."""
    running: list[subprocess.Popen[str]] = []

    def run(module: str, package: str = "omm_recorder", **parameters: object) -> Any:
        words = [w for name, value in parameters.items() for w in ("-p", f"{name}:={value}")]
        code = f"import sys; from {package}.{module} import main; sys.exit(main())"
        environment = {**python_environment, **{k: os.environ[k] for k in _OURS if k in os.environ}}
        process = subprocess.Popen(
            [sys.executable, "-c", code, "--ros-args", *words],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        return process

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


_OURS = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", *PROFILE_VARIABLES)


def wait_for(condition: Callable[[], Any], what: str, seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, f"waited in vain for {what}"
        time.sleep(0.02)


def publisher(node: Any, topic: str, type_name: str, qos: TopicQos | None = None) -> Any:
    profile = profile_from_qos(qos or TopicQos(depth=1000))
    made = node.create_publisher(message_class(type_name), topic, profile)
    wait_for(made.get_subscription_count, f"a listener to {topic}")
    return made


def recorded(run: Path, topic: str) -> list[bytes]:
    with Recording(run) as recording:
        return [bytes(m.data) for m in recording.messages([topic])]


def has(folder: Path, topic: str, number: int) -> Callable[[], bool]:
    """Whether the recording under way has that many messages: in the bytes that are on disk."""

    def check() -> bool:
        unfinished = folder / f"run.mcap{UNFINISHED}"
        if not unfinished.exists():
            return False
        copy = folder / f"copy-{time.monotonic_ns()}.mcap"
        snapshot = folder / "snapshot"
        snapshot.write_bytes(unfinished.read_bytes())
        try:
            repair(snapshot, copy)
            return len(recorded(copy, topic)) >= number
        finally:
            copy.unlink(missing_ok=True)
            snapshot.unlink()

    return check


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_records_every_byte_and_ends_cleanly(
    node: Any, start: Any, tmp_path: Path, messages: Any, ending: signal.Signals
) -> None:
    recorder = start("node", folder=tmp_path / "run")
    poses = publisher(node, POSES, "geometry_msgs/msg/PoseStamped")
    images = publisher(node, IMAGES, "sensor_msgs/msg/Image")
    sent_poses = [messages.pose(k + 1, 0.001 * k) for k in range(300)]
    random = np.random.default_rng(1)
    sent_images = [
        messages.image(k + 1, random.integers(0, 255, (1944, 2592), dtype=np.uint8))
        for k in range(4)
    ]
    for k, pose in enumerate(sent_poses):
        poses.publish(pose)
        if k % 75 == 10:
            images.publish(sent_images[k // 75])
        time.sleep(0.002)
    for made in (poses, images):
        assert made.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    recorder.send_signal(ending)
    _, errors = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, errors
    assert "none lost" in errors
    assert recorded(tmp_path / "run", POSES) == sent_poses
    assert recorded(tmp_path / "run", IMAGES) == sent_images
    assert verify(tmp_path / "run" / "run.mcap").intact
    tally = {t.name: t.tally for t in inspect(tmp_path / "run").topics}
    assert tally[POSES]["missing_from_publisher"] == tally[POSES]["lost_by_recorder"] == 0


@pytest.mark.parametrize(("told", "words"), [(107, "7 LOST"), (100, "none lost"), (None, "known")])
def test_what_is_missing_at_the_end_is_asked_for_and_told(
    node: Any, start: Any, tmp_path: Path, messages: Any, told: int | None, words: str
) -> None:
    recorder = start("node", folder=tmp_path / "run")
    poses = publisher(node, POSES, "geometry_msgs/msg/PoseStamped")
    health = publisher(node, "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    for k in range(100):
        poses.publish(messages.pose(k + 1, 0.001 * k))
    assert poses.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    counts = [] if told is None else [KeyValue(key=POSES, value=str(told))]
    status = DiagnosticStatus(name="cnc_bridge: published", values=counts)
    health.publish(DiagnosticArray(status=[status]))
    assert health.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    recorder.send_signal(signal.SIGINT)
    while recorder.poll() is None:  # a publisher that goes on telling
        health.publish(DiagnosticArray(status=[status]))
        time.sleep(0.05)
    _, errors = recorder.communicate(timeout=60)
    assert words in errors
    assert (POSES in errors.partition("not known")[2]) == (told is None)
    tally = {t.name: t.tally for t in inspect(tmp_path / "run").topics}[POSES]
    assert tally["missing_at_end"] == (None if told is None else told - 100)
    assert tally["missing_from_publisher"] == (told or 100) - 100


def test_the_nodes_of_omm_tell_how_many_messages_they_published(node: Any) -> None:
    counting = CountingNode("counting", context=node.context)
    poses = counting.create_publisher(
        message_class("geometry_msgs/msg/PoseStamped"), "/some/poses", 10
    )
    diagnostics = Diagnostics(counting)
    told: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", told.append, 10)
    wait_for(lambda: node.count_publishers("/diagnostics"), "its publisher")
    for _ in range(3):
        poses.publish(message_class("geometry_msgs/msg/PoseStamped")())
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spun() -> bool:
        diagnostics.publish()
        executor.spin_once(timeout_sec=0.1)
        return bool(told)

    wait_for(spun, "its diagnostics")
    (status,) = (s for s in told[-1].status if s.name.endswith(": published"))
    assert {v.key: v.value for v in status.values}["/some/poses"] == "3"
    counting.destroy_node()


def test_a_lifecycle_node_counts_what_it_publishes_while_it_is_active(node: Any) -> None:
    counting = CountingLifecycleNode("counting", context=node.context)
    pose = message_class("geometry_msgs/msg/PoseStamped")
    poses = counting.create_lifecycle_publisher(pose, "/some/poses", 10)
    poses.publish(pose())
    assert published(counting)["/some/poses"] == 0
    counting.trigger_configure()
    counting.trigger_activate()
    poses.publish(pose())
    assert published(counting)["/some/poses"] == 1
    counting.trigger_deactivate()
    poses.publish(pose())
    assert published(counting)["/some/poses"] == 1
    counting.destroy_node()


@pytest.mark.parametrize(
    "wishes",
    [[signal.SIGINT] * 2, [signal.SIGTERM] * 2, [signal.SIGINT, signal.SIGTERM] * 20],
    ids=["two SIGINT", "two SIGTERM", "forty of both"],
)
def test_a_recording_that_is_being_closed_is_closed_whatever_comes(
    node: Any, start: Any, tmp_path: Path, messages: Any, wishes: list[signal.Signals]
) -> None:
    recorder = start("node", folder=tmp_path / "run")
    images = publisher(node, IMAGES, "sensor_msgs/msg/Image")
    random = np.random.default_rng(1)
    sent = [
        messages.image(k + 1, random.integers(0, 255, (1944, 2592), dtype=np.uint8))
        for k in range(8)
    ]
    for image in sent:
        images.publish(image)
        time.sleep(0.1)
    assert images.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    for wish in wishes:
        if recorder.poll() is None:
            recorder.send_signal(wish)
        time.sleep(0.005)
    _, errors = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, errors
    assert "Traceback" not in errors
    assert recorded(tmp_path / "run", IMAGES) == sent
    assert verify(tmp_path / "run" / "run.mcap").intact


def test_kill_9_leaves_what_was_recorded(
    node: Any, start: Any, tmp_path: Path, messages: Any
) -> None:
    recorder = start("node", folder=tmp_path / "run")
    poses = publisher(node, POSES, "geometry_msgs/msg/PoseStamped")
    sent = [messages.pose(k + 1, 0.001 * k) for k in range(50)]
    for pose in sent:
        poses.publish(pose)
    wait_for(has(tmp_path / "run", POSES, 50), "50 poses")
    recorder.kill()
    recorder.communicate()
    unfinished = tmp_path / "run" / f"run.mcap{UNFINISHED}"
    repair(unfinished, repaired_name(unfinished))
    assert recorded(tmp_path / "run", POSES) == sent


def test_a_recorder_started_again_after_kill_9_records_and_tells_what_lies_there(
    node: Any, start: Any, tmp_path: Path, messages: Any
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    left = run / f"run.mcap{UNFINISHED}"
    left.write_bytes(b"what a killed recorder left")
    told: list[DiagnosticStatus] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: told.extend(m.status), 10)
    recorder = start("node", folder=run)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def recording() -> DiagnosticStatus | None:
        executor.spin_once(timeout_sec=0.1)
        return next((s for s in told if s.name.startswith("recorder: recording")), None)

    wait_for(recording, "the recorder's health")
    values = {v.key: v.value for v in recording().values}
    (aside,) = run.glob(f"run-interrupted-*{UNFINISHED}")
    assert aside.read_bytes() == b"what a killed recorder left"
    assert values["interrupted"] == str(aside)
    assert recording().level == DiagnosticStatus.WARN
    executor.shutdown()
    recorder.send_signal(signal.SIGINT)
    _, errors = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, errors
    assert f"./omm repair {aside}" in errors
    assert verify(run / "run.mcap").intact


def test_parameters_files_and_versions_are_recorded(node: Any, start: Any, tmp_path: Path) -> None:
    part = tmp_path / "plate.yaml"
    part.write_text("part: {name: plate}\n")
    node.declare_parameter("exposure_us", 800)
    recorder = start("node", folder=tmp_path / "run", part_file=part)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    seen = tmp_path / "run" / f"run.mcap{UNFINISHED}"
    until = time.monotonic() + 60.0
    # The tester answers the recorder's question for its parameters.
    while not (seen.exists() and b"exposure_us" in seen.read_bytes()):
        assert time.monotonic() < until
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    summary = inspect(tmp_path / "run")
    assert summary.parameters["/tester"]["exposure_us"] == "800"
    assert set(summary.attached) == {"part.yaml"}
    assert {"omm", "ros_distro", "python", "numpy", "rclpy"} <= set(summary.provenance)


SECRET = "root:$6$secret:19000:0:99999:7:::\n"


def test_that_a_parameter_changed_is_believed_of_its_node_only(
    node: Any, start: Any, tmp_path: Path
) -> None:
    (tmp_path / "part.yaml").write_text("part: {name: nobody's}\n")
    recorder = start("node", folder=tmp_path / "run")
    forged = ParameterEvent(node="/estimator")
    value = ParameterValue(type=4, string_value=str(tmp_path / "part.yaml"))
    forged.changed_parameters = [ParameterMessage(name="part_file", value=value)]
    events = publisher(node, "/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    wait_for(lambda: recording_parameters(tmp_path / "run", "recorder"), "a recorder that listens")
    events.publish(forged)
    assert events.wait_for_all_acked(rclpy.duration.Duration(seconds=30))
    wait_for(has(tmp_path / "run", "/parameter_events", 1), "the forged event")
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    assert inspect(tmp_path / "run").attached == {}


def recording_parameters(folder: Path, name: str) -> bool:
    seen = folder / f"run.mcap{UNFINISHED}"
    return seen.exists() and f"omm_parameters /{name}".encode() in seen.read_bytes()


def test_of_the_estimators_files_only_those_of_their_kind_are_recorded(
    domain: None, start: Any, tmp_path: Path
) -> None:
    secret, part = tmp_path / "shadow", tmp_path / "part.yaml"
    secret.write_text(SECRET)
    part.write_text("part: {name: plate}\n")
    part.chmod(0o640)
    context = rclpy.Context()
    rclpy.init(context=context)
    estimator = rclpy.create_node("estimator", context=context)
    estimator.declare_parameter("part_file", str(secret))
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(estimator)
    recorder = start("node", folder=tmp_path / "run")
    unfinished = tmp_path / "run" / f"run.mcap{UNFINISHED}"

    def spun(what: Callable[[], bool]) -> Callable[[], bool]:
        return lambda: executor.spin_once(timeout_sec=0.05) or what()

    try:
        wait_for(spun(lambda: recording_parameters(tmp_path / "run", "estimator")), "its answer")
        assert unfinished.stat().st_mode & 0o044 == 0o044
        estimator.set_parameters([Parameter("part_file", value=str(part))])
        wait_for(spun(lambda: b"name: plate" in unfinished.read_bytes()), "the part")
    finally:
        executor.shutdown()
        rclpy.shutdown(context=context)
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    assert set(inspect(tmp_path / "run").attached) == {"part.yaml"}
    assert SECRET.encode() not in (tmp_path / "run" / "run.mcap").read_bytes()
    # Who may not read the part may not read it in the recording.
    assert (tmp_path / "run" / "run.mcap").stat().st_mode & 0o777 == 0o640


def test_a_best_effort_camera_is_recorded_too(
    node: Any, start: Any, tmp_path: Path, messages: Any
) -> None:
    recorder = start("node", folder=tmp_path / "run")
    qos = TopicQos(reliable=False, depth=5)
    images = publisher(node, IMAGES, "sensor_msgs/msg/Image", qos)
    image = messages.image(1, np.zeros((48, 64), np.uint8))
    until = time.monotonic() + 60.0
    while not has(tmp_path / "run", IMAGES, 1)():
        assert time.monotonic() < until
        images.publish(image)
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    assert set(recorded(tmp_path / "run", IMAGES)) == {image}


def test_topics_of_others_are_recorded_when_named(node: Any, start: Any, tmp_path: Path) -> None:
    from std_msgs.msg import String

    recorder = start("node", folder=tmp_path / "run", topics="['/shop/order']")
    orders = publisher(node, "/shop/order", "std_msgs/msg/String")
    orders.publish(String(data="4711"))
    wait_for(has(tmp_path / "run", "/shop/order", 1), "the order")
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    with AnyReader([tmp_path / "run"]) as reader:
        (connection,) = [c for c in reader.connections if c.topic == "/shop/order"]
        ((_, _, data),) = reader.messages([connection])
        assert reader.deserialize(data, connection.msgtype).data == "4711"


def test_a_second_recorder_on_the_same_run_is_refused(start: Any, tmp_path: Path) -> None:
    first = start("node", folder=tmp_path / "run")
    wait_for((tmp_path / "run" / f"run.mcap{UNFINISHED}").exists, "the first recorder")
    second = start("node", folder=tmp_path / "run")
    _, errors = second.communicate(timeout=60)
    assert second.returncode == 2
    assert "Another recorder writes" in errors
    assert "Traceback" not in errors
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=60)
    assert first.returncode == 0


@pytest.mark.parametrize("topic", KNOWN, ids=lambda topic: topic.name)
def test_definitions_are_complete_and_of_the_right_version(topic: Any) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(topic.type_name), topic.type_name))
    assert store.hash_rihs01(topic.type_name) == type_hash(topic.type_name)


class Listener:
    """Takes the bytes of a topic."""

    def __init__(self, node: Any, topic: str, type_name: str) -> None:
        self.taken: list[bytes] = []
        node.create_subscription(
            message_class(type_name),
            topic,
            self.taken.append,
            profile_from_qos(TopicQos(depth=1000)),
            raw=True,
        )


@pytest.fixture
def listeners(node: Any) -> tuple[Listener, Listener, Listener]:
    return (
        Listener(node, POSES, "geometry_msgs/msg/PoseStamped"),
        Listener(node, IMAGES, "sensor_msgs/msg/Image"),
        Listener(node, "/clock", "rosgraph_msgs/msg/Clock"),
    )


def spin_until_over(node: Any, process: Any, seconds: float = 60.0) -> str:
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    until = time.monotonic() + seconds
    while process.poll() is None:
        assert time.monotonic() < until, "the replay does not end"
        executor.spin_once(timeout_sec=0.05)
    for _ in range(100):
        executor.spin_once(timeout_sec=0.0)
    executor.shutdown()
    return str(process.communicate()[1])


def test_replay_publishes_the_same_bytes_in_the_same_order(
    node: Any, start: Any, listeners: Any, record: Any, samples: Any
) -> None:
    poses, images, clock = listeners
    replay = start("replay", run=record(), rate=5.0)
    errors = spin_until_over(node, replay)
    assert replay.returncode == 0, errors
    assert poses.taken == [s.data for s in samples if s.topic == POSES]
    assert images.taken == [s.data for s in samples if s.topic == IMAGES]
    store = get_typestore(Stores.ROS2_JAZZY)
    times = [store.deserialize_cdr(c, "rosgraph_msgs/msg/Clock").clock for c in clock.taken]
    stamps = [t.sec * 1_000_000_000 + t.nanosec for t in times]
    assert stamps == sorted(stamps)
    assert stamps[0] == samples[0].log_ns
    assert stamps[-1] <= samples[-1].log_ns


def test_replay_of_a_part_of_the_time_and_the_topics(
    node: Any, start: Any, listeners: Any, record: Any, samples: Any
) -> None:
    poses, images, clock = listeners
    replay = start(
        "replay", run=record(), rate=10.0, start_s=1.0, topics=f"['{POSES}']", clock="false"
    )
    assert spin_until_over(node, replay) is not None
    begin = samples[0].log_ns + 1_000_000_000
    assert poses.taken == [s.data for s in samples if s.topic == POSES and s.log_ns >= begin]
    assert images.taken == clock.taken == []


MACHINE = """machine: {name: mill, urdf: mill.urdf}
uncertainty: {stop_sigma_mm: 0.001, geometry_sigma_mm: 0.0}
"""


def test_the_live_estimator_fed_by_a_replay_comes_to_the_recorded_result(
    node: Any, start: Any, bench: Path, tmp_path: Path
) -> None:
    from omm_interfaces.msg import PartEstimate

    files = {"part_file": bench / "part.yaml", "calibration_file": bench / "camera.yaml"}
    machine = tmp_path / "mill.yaml"
    machine.write_text(MACHINE)
    files["machine_file"] = machine
    recorder = start("node", folder=tmp_path / "run", compression="none")
    start("node", package="omm_estimator", **files)
    images = len(recorded(bench, IMAGES))
    estimates: list[Any] = []
    qos = profile_from_qos(TopicQos(depth=1, latched=True))
    node.create_subscription(PartEstimate, "/omm/estimate", estimates.append, qos)
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    wait_for(lambda: node.count_subscribers(IMAGES) == 2, "recorder and estimator")
    replay = start("replay", run=bench, rate=1.0, wait_s=60.0)
    until = time.monotonic() + 120.0
    while not (
        estimates
        and estimates[-1].images_received == images
        and estimates[-1].images_pending == 0
        and replay.poll() is not None
    ):
        assert time.monotonic() < until, (
            f"replay {replay.poll()}, estimates of images: "
            f"{[(e.images_received, e.images_pending) for e in estimates]}"
        )
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=60)
    solved = solve_run(tmp_path / "run")
    assert solved.recorded is not None
    live = [float(value) for value in estimates[-1].theta]
    assert list(solved.recorded.theta_si) == live
    unit = [1.0, 1.0, 1.0, 1000.0, 1000.0, 1000.0, 1.0]
    solution = solved.result.solution
    assert [float(v) / u for v, u in zip(solution.theta, unit)] == live
    told = [float(value) for value in estimates[-1].expanded_uncertainty]
    assert [float(v) / u for v, u in zip(solution.expanded_uncertainty, unit)] == told
    assert solved.machine is not None  # it was recorded with the run
    assert estimates[-1].geometry_declared
    again = solve_run(bench, SolveRunOptions(machine_file=machine)).result.to_json_dict()
    assert solved.result.to_json_dict() == again


def test_solving_again_uses_every_parameter_of_the_estimator() -> None:
    """All away from their defaults: what is not taken over comes out different."""
    from omm_core.files.machine import MachineUncertainty
    from omm_estimator.parameters import Parameters

    values = {
        "model": "6d",
        "gamma_s_rad": 1e-4,
        "machine_sigma_mm": 0.002,
        "worst_machine_mm": 0.2,
        "standstill_tolerance_mm": 0.007,
        "standstill_tolerance_rad": 3e-5,
        "standstill_window_s": 0.2,
        "standstill_gap_s": 0.07,
        "polarity": "bright",
        "max_dot_diameter_px": 300.0,
        "centring": "outline",
    }
    used = {f.name for f in dataclasses.fields(Parameters)} - {
        *("part_file", "calibration_file", "part_frame", "frame_prefix", "publish_tf", "network"),
        "machine_file",  # attached to the recording, as the part is
        "left_out_ns",  # of this run's images
    }
    assert set(values) == used
    exact = MachineUncertainty()
    assert options_from(values) == Parameters(**values).measurement_options(exact)
    assert options_from({}) == Parameters().measurement_options(exact)
    assert left_out({"left_out_ns": [1, 2]}) == {1, 2}


def spin_until_taken(node: Any, listener: Listener, number: int) -> None:
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    until = time.monotonic() + 60.0
    while len(listener.taken) < number:
        assert time.monotonic() < until
        executor.spin_once(timeout_sec=0.05)
    executor.shutdown()


def test_replay_in_a_loop_begins_again_until_it_is_ended(
    node: Any, start: Any, listeners: Any, record: Any, samples: Any
) -> None:
    poses, _, _ = listeners
    replay = start("replay", run=record(), rate=100.0, loop="true")
    once = [s.data for s in samples if s.topic == POSES]
    spin_until_taken(node, poses, 2 * len(once))
    assert poses.taken[: 2 * len(once)] == once * 2
    replay.send_signal(signal.SIGINT)
    _, errors = replay.communicate(timeout=30)
    assert replay.returncode == 0, errors


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after_s", [0.0, 0.003, 0.01, 0.03])
def test_told_to_end_amid_messages_replay_ends_cleanly(
    number: int, after_s: float, node: Any, start: Any, listeners: Any, record: Any
) -> None:
    poses, _, _ = listeners
    replay = start("replay", run=record(), rate=100.0, loop="true")
    spin_until_taken(node, poses, 1)
    time.sleep(after_s)
    replay.send_signal(number)
    _, errors = replay.communicate(timeout=30)
    assert replay.returncode == 0, errors
    assert "Traceback" not in errors


def test_replay_tells_what_is_wrong(start: Any, tmp_path: Path, record: Any) -> None:
    for parameters, words in (
        ({"run": tmp_path / "absent.mcap"}, "does not exist"),
        ({"run": record(), "topics": "['/nothing']"}, "Expected /nothing in the recording"),
        ({"run": tmp_path, "rate": -1.0}, "rate"),
    ):
        process = start("replay", **parameters)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 2
        assert words in errors
        assert "Traceback" not in errors


def test_a_file_that_cannot_be_read_ends_the_ok(
    node: Any, start: Callable[..., Any], tmp_path: Path
) -> None:
    """A recording without its part file cannot be solved: nobody shall learn that afterwards."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    estimator = rclpy.create_node("estimator", context=node.context)
    estimator.declare_parameter("part_file", str(tmp_path / "away" / "part.yaml"))
    heard: dict[str, Any] = {}
    node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda message: heard.update({s.name: s for s in message.status}),
        10,
    )
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    executor.add_node(estimator)
    recorder = start("node", folder=tmp_path / "run")
    deadline_s = time.monotonic() + 60.0

    def told() -> bool:
        line = heard.get("recorder: recording")
        return line is not None and "part.yaml" in line.message

    while not told() and time.monotonic() < deadline_s:
        executor.spin_once(timeout_sec=0.1)
    assert told(), heard
    assert heard["recorder: recording"].level == DiagnosticStatus.WARN
    executor.shutdown()
    estimator.destroy_node()
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(30) == 0
