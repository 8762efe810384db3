"""What omm records, others read: every message, every stamp, every definition."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from omm_core.errors import InputError
from omm_recording.inspecting import inspect
from omm_recording.rosbag2_format import TopicQos, dumped, parsed_qos, qos_profiles
from omm_recording.run_files import UNFINISHED
from omm_recording.writing import RecordingOptions, RecordingWriter

COMPRESSIONS = ["none", "lz4", "zstd"]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_mcap_library_reads_every_message_and_checksum(
    record: Any, samples: Any, compression: str
) -> None:
    path = record(compression=compression)
    with path.open("rb") as file:
        read = [
            (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, c, m in make_reader(file, validate_crcs=True).iter_messages()
        ]
    assert read == [s.key for s in samples]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_mcap_library_reads_it_from_a_pipe(record: Any, samples: Any, compression: str) -> None:
    with record(compression=compression).open("rb") as file:
        messages = NonSeekingReader(file, validate_crcs=True).iter_messages()
        assert [m.data for _, _, m in messages] == [s.data for s in samples]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_rosbags_reads_the_file_and_the_folder(record: Any, samples: Any, compression: str) -> None:
    path = record(compression=compression)
    for place in (path, path.parent):
        with Reader(place) as reader:
            read = [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]
            assert reader.message_count == len(samples)
        assert read == [(s.topic, s.log_ns, s.data) for s in samples]


def test_rosbags_decodes_every_message_by_the_definitions_in_the_file(
    record: Any, samples: Any
) -> None:
    with AnyReader([record().parent]) as reader:
        stamps = [
            reader.deserialize(data, connection.msgtype).header.stamp
            for connection, _, data in reader.messages()
        ]
    assert len(stamps) == len(samples)
    assert all(stamp.sec >= 1_700_000_000 for stamp in stamps)


def test_topics_carry_their_quality_of_service_and_type_hash(record: Any, topics: Any) -> None:
    with Reader(record().parent) as reader:
        found = {c.topic: c for c in reader.connections}
    for topic in topics:
        (qos,) = found[topic.name].ext.offered_qos_profiles
        assert (qos.reliability, qos.depth) == (QosReliability.RELIABLE, topic.qos.depth)
        assert qos.durability == QosDurability.VOLATILE
        assert found[topic.name].digest == topic.type_hash


@pytest.mark.parametrize("reliable", [True, False])
@pytest.mark.parametrize("latched", [True, False])
def test_quality_of_service_survives_being_written(reliable: bool, latched: bool) -> None:
    qos = TopicQos(reliable=reliable, latched=latched, depth=7)
    assert parsed_qos(dumped(qos_profiles(qos))) == qos


def test_quality_of_service_in_the_numbers_of_older_versions() -> None:
    text = "- {history: 1, depth: 5, reliability: 2, durability: 1}"
    assert parsed_qos(text) == TopicQos(reliable=False, latched=True, depth=5)


def test_metadata_beside_and_inside_say_the_same(record: Any, samples: Any) -> None:
    path = record()
    beside = yaml.safe_load((path.parent / "metadata.yaml").read_text())
    with path.open("rb") as file:
        tables = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    inside = yaml.safe_load(tables["rosbag2"]["serialized_metadata"])
    assert beside == {"rosbag2_bagfile_information": inside}
    assert inside["message_count"] == len(samples)
    assert inside["relative_file_paths"] == ["run.mcap"]


def test_images_lie_in_chunks_of_their_own(record: Any) -> None:
    with record().open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    assert all(len(chunk.message_index_offsets) == 1 for chunk in chunks)


def test_files_inside_come_with_their_checksums(record: Any) -> None:
    attached = inspect(record()).attached
    assert set(attached) == {"part.yaml"}
    assert attached["part.yaml"] == hashlib.sha256(b"part: {name: plate}\n").hexdigest()


def test_the_name_appears_only_when_the_recording_is_whole(
    tmp_path: Path, topics: Any, samples: Any
) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    writer.add_topic(topics[1])
    writer.write(topics[1].name, 1, 1, 1, samples[0].data)
    assert [p.name for p in tmp_path.iterdir()] == [f"run.mcap{UNFINISHED}"]
    writer.close({})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["metadata.yaml", "run.mcap"]


def test_a_finished_recording_is_never_overwritten(record: Any) -> None:
    path = record()
    before = path.read_bytes()
    with pytest.raises(InputError, match="never overwritten"):
        RecordingWriter(path, RecordingOptions())
    assert path.read_bytes() == before


def test_one_recording_has_one_recorder(tmp_path: Path) -> None:
    first = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    with pytest.raises(InputError, match="Another recorder writes"):
        RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    assert first.close({}).is_file()


def test_an_interrupted_recording_is_not_written_over(tmp_path: Path) -> None:
    unfinished = tmp_path / f"run.mcap{UNFINISHED}"
    unfinished.write_bytes(b"what a crash left")
    with pytest.raises(InputError, match=r"\./omm repair"):
        RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    assert unfinished.read_bytes() == b"what a crash left"


def test_a_recording_that_cannot_begin_leaves_nothing(tmp_path: Path) -> None:
    # Without the library there is another reason, with the same outcome.
    with pytest.raises(InputError, match=r"private key|cryptography"):
        RecordingWriter(tmp_path / "run.mcap", RecordingOptions(key_file=tmp_path / "absent"))
    with pytest.raises(InputError, match="Expected one of none, lz4, zstd"):
        RecordingWriter(tmp_path / "run.mcap", RecordingOptions(compression="rar"))
    assert list(tmp_path.iterdir()) == []


def test_an_empty_recording_is_sound(tmp_path: Path, topics: Any) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    writer.add_topic(topics[0])
    path = writer.close({"ended_because": "stopped"})
    summary = inspect(path)
    assert (summary.topics[0].messages, summary.chunks) == (0, 0)
    with Reader(path) as reader:
        assert list(reader.messages()) == []


def test_the_report_counts_what_was_lost(tmp_path: Path, topics: Any, samples: Any) -> None:
    tally = {"received": 3, "recorded": 1, "lost_by_recorder": 2, "missing_from_publisher": 4}
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    writer.add_topic(topics[1])
    writer.write(topics[1].name, 1, 1, 1, samples[0].data)
    path = writer.close({topics[1].name: json.dumps(tally), "ended_because": "stopped"})
    (topic,) = inspect(path).topics
    assert topic.tally == tally
