"""Small recordings of a camera and a spindle, made with the libraries of others and with ours."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from whole_suite import shared_data

from omm_recording.rosbag2_format import TopicQos
from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord

IMAGE = "sensor_msgs/msg/Image"
POSE = "geometry_msgs/msg/PoseStamped"
START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One message to record."""

    topic: str
    type_name: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes

    @property
    def key(self) -> tuple[str, int, int, int, bytes]:
        """What must come back."""
        return (self.topic, self.log_ns, self.publish_ns, self.sequence, self.data)


class Messages:
    """Makes serialised messages without ROS."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def definition(self, type_name: str) -> str:
        return self.store.generate_msgdef(type_name, ros_version=2)[0]

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def image(self, stamp_ns: int, pixels: np.ndarray, encoding: str = "mono8") -> bytes:
        message = self.store.types[IMAGE](
            header=self.header(stamp_ns, "camera_optical"),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(pixels.dtype.byteorder == ">"),
            step=pixels.strides[0],
            data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
        )
        return bytes(self.store.serialize_cdr(message, IMAGE))

    def pose(self, stamp_ns: int, x_m: float) -> bytes:
        types = self.store.types
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x_m, y=0.0, z=0.0),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        )
        message = types[POSE](header=self.header(stamp_ns, "machine"), pose=pose)
        return bytes(self.store.serialize_cdr(message, POSE))


@pytest.fixture(scope="session")
def messages() -> Messages:
    return Messages()


@pytest.fixture(scope="session")
def samples(messages: Messages) -> list[Sample]:
    """Two seconds: 100 poses/s and 4 images/s of 640 x 480, in the order of their log times."""
    random = np.random.default_rng(5)
    result = []
    for k in range(200):
        stamp = START_NS + k * 10_000_000
        data = messages.pose(stamp, 0.001 * k)
        result.append(
            Sample(
                topic="/cnc/spindle_pose",
                type_name=POSE,
                log_ns=stamp + 400_000,
                publish_ns=stamp + 100_000,
                sequence=k + 1,
                data=data,
            )
        )
        if k % 25 == 12:
            pixels = random.integers(0, 60, (480, 640), dtype=np.uint8)
            stamp += 3_000_000
            result.append(
                Sample(
                    topic="/camera/image_raw",
                    type_name=IMAGE,
                    log_ns=stamp + 5_000_000,
                    publish_ns=stamp + 2_000_000,
                    sequence=k // 25 + 1,
                    data=messages.image(stamp, pixels),
                )
            )
    return sorted(result, key=lambda sample: sample.log_ns)


@pytest.fixture(scope="session")
def topics(messages: Messages) -> list[TopicToRecord]:
    return [
        TopicToRecord(
            name=name,
            type_name=type_name,
            definition=messages.definition(type_name),
            type_hash=messages.store.hash_rihs01(type_name),
            qos=TopicQos(depth=depth),
        )
        for name, type_name, depth in (
            ("/camera/image_raw", IMAGE, 5),
            ("/cnc/spindle_pose", POSE, 500),
        )
    ]


@pytest.fixture
def record(tmp_path: Path, samples: list[Sample], topics: list[TopicToRecord]) -> Any:
    """Record the samples with our writer; returns the file."""

    def make(folder: str = "run", **options: Any) -> Path:
        writer = RecordingWriter(tmp_path / folder / "run.mcap", RecordingOptions(**options))
        for topic in topics:
            writer.add_topic(topic)
        writer.add_file("part.yaml", b"part: {name: plate}\n", START_NS)
        for number, s in enumerate(samples):
            writer.write(s.topic, s.sequence, s.log_ns, s.publish_ns, s.data)
            if number % 20 == 19:  # as the recorder does by time
                writer.flush()
        return writer.close({"ended_because": "stopped"})

    return make


@pytest.fixture(scope="session")
def python_environment() -> dict[str, str]:
    """For processes that the tests start: they find what the tests find."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


@pytest.fixture(scope="session")
def bench() -> Path:
    return shared_data("bench")
