"""Recordings of others are read, however they were written; what is none is refused."""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from omm_core.errors import InputError
from omm_recording.decoding import IMAGE_TYPE, POSE_TYPE, image_pixels, machine_T_spindle, stamp_ns
from omm_recording.reading import Recording

IMAGES = "/camera/image_raw"
POSES = "/cnc/spindle_pose"


def contents(run: Path, **selection: Any) -> list[tuple[str, int, int, int, bytes]]:
    with Recording(run) as recording:
        return [
            (m.topic, m.log_time_ns, m.publish_time_ns, m.sequence, bytes(m.data))
            for m in recording.messages(**selection)
        ]


def write_with_mcap(path: Path, samples: Any, messages: Any, **options: Any) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2")
        channels = {}
        for s in samples:
            if s.topic not in channels:
                text = messages.definition(s.type_name).encode()
                schema = writer.register_schema(s.type_name, "ros2msg", text)
                channels[s.topic] = writer.register_channel(s.topic, "cdr", schema)
            writer.add_message(channels[s.topic], s.log_ns, s.data, s.publish_ns, s.sequence)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.ZSTD, "chunk_size": 4096},
        {"use_chunking": False},
        {"use_chunking": False, "use_statistics": False, "index_types": IndexType.NONE},
        {"index_types": IndexType.NONE, "use_statistics": False},
        {"index_types": IndexType.CHUNK},
        {
            "index_types": IndexType.NONE,
            "repeat_channels": False,
            "repeat_schemas": False,
            "use_statistics": False,
            "use_summary_offsets": False,
        },
    ],
    ids=str,
)
def test_reads_every_way_of_laying_out_an_mcap(
    tmp_path: Path, samples: Any, messages: Any, options: dict[str, Any]
) -> None:
    path = write_with_mcap(tmp_path / "any.mcap", samples, messages, **options)
    assert contents(path) == [s.key for s in samples]


def write_with_rosbags(folder: Path, samples: Any, messages: Any, **options: Any) -> Path:
    with_compression = options.pop("mode", None)
    writer = BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if with_compression:
        writer.set_compression(with_compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for s in samples:
            if s.topic not in connections:
                connections[s.topic] = writer.add_connection(
                    s.topic, s.type_name, typestore=messages.store
                )
            writer.write(connections[s.topic], s.log_ns, s.data)
    return folder


@pytest.mark.parametrize(
    "mode",
    [None, CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE],
    ids=["plain", "file", "message", "storage"],
)
def test_reads_rosbag2_folders_in_all_compressions(
    tmp_path: Path, samples: Any, messages: Any, mode: Any
) -> None:
    bag = write_with_rosbags(tmp_path / "bag", samples, messages, mode=mode)
    assert [(c[0], c[1], c[4]) for c in contents(bag)] == [
        (s.topic, s.log_ns, s.data) for s in samples
    ]


def test_reads_a_message_compressed_file_without_its_folder(
    tmp_path: Path, samples: Any, messages: Any
) -> None:
    bag = write_with_rosbags(tmp_path / "bag", samples, messages, mode=CompressionMode.MESSAGE)
    (bag / "metadata.yaml").unlink()
    assert [c[4] for c in contents(next(bag.glob("*.mcap")))] == [s.data for s in samples]


def test_joins_the_files_of_a_split_recording(tmp_path: Path, samples: Any, messages: Any) -> None:
    write_with_mcap(tmp_path / "bag_0.mcap", samples[:90], messages)
    write_with_mcap(tmp_path / "bag_1.mcap", samples[90:], messages)
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  storage_identifier: mcap\n"
        "  relative_file_paths: [bag_0.mcap, bag_1.mcap]\n"
    )
    assert contents(tmp_path) == [s.key for s in samples]
    with Recording(tmp_path) as recording:
        assert sum(t.messages or 0 for t in recording.topics.values()) == len(samples)


def test_messages_come_in_the_order_of_their_log_times(
    tmp_path: Path, samples: Any, messages: Any
) -> None:
    shuffled = [samples[i] for i in np.random.default_rng(1).permutation(len(samples))]
    path = write_with_mcap(tmp_path / "any.mcap", shuffled, messages, chunk_size=2000)
    assert [c[1] for c in contents(path)] == [s.log_ns for s in samples]


def test_selects_topics_and_times(record: Any, samples: Any) -> None:
    start, end = samples[50].log_ns, samples[150].log_ns
    expected = [s.key for s in samples if s.topic == POSES and start <= s.log_ns < end]
    assert contents(record(), topics=[POSES], start_ns=start, end_ns=end) == expected


def test_equal_to_the_mcap_library_on_a_recording_of_others(bench: Path) -> None:
    with (bench / "run.mcap").open("rb") as file:
        expected = [
            (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, c, m in make_reader(file, validate_crcs=True).iter_messages()
        ]
    assert sorted(contents(bench)) == sorted(expected)


def test_images_are_views_of_the_recorded_bytes(bench: Path) -> None:
    with Recording(bench) as recording:
        message = next(recording.messages([IMAGES]))
        image = image_pixels(recording.decode(message))
    assert image.shape == (1944, 2592)
    assert np.shares_memory(image, np.frombuffer(message.data, dtype=np.uint8))


@pytest.mark.parametrize("kind", ["<u2", ">u2"])
def test_16_bit_images_of_either_byte_order(
    tmp_path: Path, messages: Any, samples: Any, kind: str
) -> None:
    pixels = np.arange(20 * 30, dtype=kind).reshape(20, 30) * 100
    data = messages.image(5, pixels, "mono16")
    assert np.array_equal(decoded(tmp_path, messages, samples, data), pixels)


def test_padding_at_the_end_of_rows_is_left_out(
    tmp_path: Path, messages: Any, samples: Any
) -> None:
    wide = np.arange(20 * 32, dtype=np.uint8).reshape(20, 32)
    data = bytearray(messages.image(5, wide))
    # The width is the second of two numbers before the encoding (length 6, "mono8" and a zero).
    at = data.index(struct.pack("<II", 20, 32))
    data[at : at + 8] = struct.pack("<II", 20, 30)
    assert np.array_equal(decoded(tmp_path, messages, samples, bytes(data)), wide[:, :30])


def decoded(tmp_path: Path, messages: Any, samples: Any, data: bytes) -> np.ndarray:
    sample = next(s for s in samples if s.topic == IMAGES)
    changed = type(sample)(**{**vars(sample), "data": data})
    path = write_with_mcap(tmp_path / "one.mcap", [changed], messages)
    with Recording(path) as recording:
        return image_pixels(recording.decode(next(recording.messages())))


def test_an_unknown_encoding_is_refused(tmp_path: Path, messages: Any, samples: Any) -> None:
    data = messages.image(5, np.zeros((4, 12), np.uint8), "jpeg")
    with pytest.raises(InputError, match=r"mono8, mono16, bgr8.*got 'jpeg'"):
        decoded(tmp_path, messages, samples, data)


def test_poses_come_in_millimetres(record: Any) -> None:
    with Recording(record()) as recording:
        poses = [recording.decode(m) for m in recording.messages([POSES])]
    assert machine_T_spindle(poses[7]).translation_mm == pytest.approx([7.0, 0.0, 0.0])
    assert stamp_ns(poses[1]) - stamp_ns(poses[0]) == 10_000_000


def test_a_pose_without_direction_is_refused(messages: Any) -> None:
    pose = messages.store.deserialize_cdr(messages.pose(1, 0.0), POSE_TYPE)
    pose.pose.orientation.w = 0.0
    with pytest.raises(InputError, match="quaternion"):
        machine_T_spindle(pose)


def refusal(run: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_all(run)
    return str(caught.value)


def read_all(run: Path) -> None:
    with Recording(run) as recording:
        recording.require(POSES, POSE_TYPE)
        recording.require(IMAGES, IMAGE_TYPE)
        list(recording.messages())


def test_tells_what_is_wrong_with_a_path(tmp_path: Path) -> None:
    assert "does not exist" in refusal(tmp_path / "absent.mcap")
    assert "Expected run.mcap" in refusal(tmp_path)
    text = tmp_path / "text.mcap"
    text.write_text("part: {name: plate}\n")
    assert "not one. It is a text file" in refusal(text)
    for start, words in (
        (b"SQLite format 3\0", "ros2 bag convert"),
        (b"#ROSBAG V2.0\n", "a bag of ROS 1"),
        (b"\x1f\x8b\x08\0\0\0\0\0", "gunzip it"),
        (b"PK\x03\x04\0\0\0\0", "unzip it"),
    ):
        text.write_bytes(start)
        assert words in refusal(text)
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    assert "Expected an MCAP recording" in refusal(empty)


def test_tells_when_a_topic_is_missing(tmp_path: Path, samples: Any, messages: Any) -> None:
    poses = [s for s in samples if s.topic == POSES]
    path = write_with_mcap(tmp_path / "poses.mcap", poses, messages)
    assert "Expected messages on /camera/image_raw" in refusal(path)
    images = [s for s in samples if s.topic == IMAGES]
    path = write_with_mcap(tmp_path / "images.mcap", images, messages)
    assert "Expected messages on /cnc/spindle_pose" in refusal(path)


def test_tells_when_the_storage_is_another(tmp_path: Path) -> None:
    (tmp_path / "bag_0.db3").write_bytes(b"SQLite format 3")
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  storage_identifier: sqlite3\n"
        "  relative_file_paths: [bag_0.db3]\n"
    )
    assert "Expected a recording in MCAP, got sqlite3" in refusal(tmp_path)


def test_a_recording_that_was_cut_short_is_refused_wherever_it_was_cut(
    record: Any, tmp_path: Path
) -> None:
    data = record(compression="none").read_bytes()
    cut = tmp_path / "cut.mcap"
    for size in np.linspace(1, len(data) - 1, 60, dtype=int):
        cut.write_bytes(data[:size])
        assert "./omm repair" in refusal(cut) or size < 8, size


def test_a_flipped_bit_in_an_image_is_noticed(record: Any, samples: Any) -> None:
    path = record(compression="none")
    data = bytearray(path.read_bytes())
    image = next(s for s in samples if s.topic == IMAGES)
    data[data.index(image.data[1000:1100])] ^= 1
    path.write_bytes(data)
    assert "another checksum than was written" in refusal(path)


def test_a_damaged_zstd_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap.zstd"
    path.write_bytes(zstandard.compress(b"x" * 100_000)[:30])
    assert "zstd" in refusal(path) or "MCAP" in refusal(path)


def test_images_that_drivers_say_otherwise_than_ros_are_read_and_told_once(capsys):
    message = SimpleNamespace(
        data=np.arange(12, dtype=np.uint8),
        encoding="Mono8",
        height=3,
        width=4,
        step=0,
        is_bigendian=0,
    )
    for _ in range(3):
        assert np.array_equal(image_pixels(message), np.arange(12).reshape(3, 4))
    said = capsys.readouterr().err
    assert said.count("omm: warning:") == 1
    assert "'Mono8'" in said
    assert "a step of 0 is read as rows without padding" in said
