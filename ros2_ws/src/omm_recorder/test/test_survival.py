"""Whatever happens to the recorder or the disk, what was written can be read."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from omm_core.errors import InputError, OmmError
from omm_recorder.recorder import Recorder
from omm_recorder.recording_state import Limits
from omm_recording.inspecting import inspect
from omm_recording.reading import Recording
from omm_recording.repairing import repair, repaired_name
from omm_recording.run_files import UNFINISHED
from omm_recording.verifying import verify
from omm_recording.writing import RecordingOptions, RecordingWriter

Keys = list[tuple[str, int, int, int, bytes]]

# Records numbered messages of 20 kB, 100 a second, and says each number once it was handed over.
WRITE_FOREVER = textwrap.dedent(
    """
    import itertools, sys, time
    from pathlib import Path
    from omm_recorder.recorder import Limits, Recorder
    from omm_recording.rosbag2_format import TopicQos
    from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord

    options = RecordingOptions(compression=sys.argv[2])
    writer = RecordingWriter(Path(sys.argv[1]) / "run.mcap", options)
    tell = lambda text: print("told", text, flush=True)
    recorder = Recorder(writer, Limits(stop_free_bytes=int(sys.argv[3])), tell)
    topic = TopicToRecord(name="/t", type_name="std_msgs/msg/String", definition="string data",
                          type_hash="", qos=TopicQos())
    recorder.add_topic(topic)
    for number in itertools.count(1):
        recorder.put("/t", number.to_bytes(8, "little") * 2500, number, time.time_ns(), number)
        print(number, time.time_ns(), flush=True)
        if not recorder.state().recording:
            break
        time.sleep(float(sys.argv[4]))
    print("ended", recorder.stop(), flush=True)
    """
)


def keys(path: Path) -> Keys:
    with Recording(path) as recording:
        return [
            (m.topic, m.log_time_ns, m.publish_time_ns, m.sequence, bytes(m.data))
            for m in recording.messages()
        ]


def started(
    folder: Path,
    environment: dict[str, str],
    *,
    compression: str = "none",
    stop_free: int = 1,
    period_s: float = 0.01,
) -> "subprocess.Popen[str]":
    command = [sys.executable, "-c", WRITE_FOREVER, str(folder), compression, str(stop_free)]
    return subprocess.Popen([*command, "0.01"], env=environment, stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_kill_9_loses_less_than_a_second(
    tmp_path: Path, python_environment: dict[str, str], compression: str
) -> None:
    process = started(tmp_path, python_environment, compression=compression)
    assert process.stdout is not None
    taken: dict[int, int] = {}
    while len(taken) < 250:
        number, time_ns = process.stdout.readline().split()
        taken[int(number)] = int(time_ns)
    process.send_signal(signal.SIGKILL)
    rest, _ = process.communicate()
    for line in rest.splitlines():
        number, time_ns = line.split()
        taken[int(number)] = int(time_ns)
    killed_ns = max(taken.values())

    unfinished = tmp_path / f"run.mcap{UNFINISHED}"
    assert [p.name for p in tmp_path.iterdir()] == [unfinished.name]
    before = unfinished.read_bytes()
    path = repaired_name(unfinished)
    repair(unfinished, path)
    assert unfinished.read_bytes() == before
    numbers = [k[3] for k in keys(path)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert all(k[4] == k[3].to_bytes(8, "little") * 2500 for k in keys(path))
    lost = [number for number in taken if number > len(numbers)]
    assert all(killed_ns - taken[number] < 1e9 for number in lost)


def test_an_unfinished_recording_is_readable_by_others_as_far_as_it_goes(
    tmp_path: Path, topics: Any, samples: Any
) -> None:
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    for topic in topics:
        writer.add_topic(topic)
    for s in samples:
        writer.write(s.topic, s.sequence, s.log_ns, s.publish_ns, s.data)
    writer.flush()
    read = []

    def read_to_the_end() -> None:
        with (tmp_path / f"run.mcap{UNFINISHED}").open("rb") as file:
            for _, channel, m in NonSeekingReader(file).iter_messages(log_time_order=False):
                read.append((channel.topic, m.log_time, m.publish_time, m.sequence, m.data))

    with pytest.raises(EndOfFile):
        read_to_the_end()
    writer.abandon()
    assert sorted(read) == sorted(s.key for s in samples)


def test_what_is_written_reaches_the_disk_by_itself(
    tmp_path: Path, topics: Any, samples: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = []
    real = os.fdatasync

    def noted(descriptor: int) -> None:
        real(descriptor)
        synced.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(os, "fdatasync", noted)
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    writer.add_topic(topics[1])
    writer.write(topics[1].name, 1, 1, 1, samples[0].data)
    writer.flush()
    size = writer.bytes_written
    until = time.monotonic() + 30.0
    while not (synced and synced[-1] >= size) and time.monotonic() < until:
        time.sleep(0.02)
    assert synced[-1] >= size
    writer.abandon()


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_cut_anywhere_the_messages_before_the_cut_come_back(
    record: Any, tmp_path: Path, compression: str
) -> None:
    path = record(compression=compression)
    whole = set(keys(path))
    data = path.read_bytes()
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    cut, repaired = tmp_path / "cut.mcap", tmp_path / "repaired.mcap"
    for size in np.linspace(200, len(data) - 1, 40, dtype=int):
        cut.write_bytes(data[:size])
        repaired.unlink(missing_ok=True)
        repair(cut, repaired)
        assert cut.read_bytes() == data[:size]
        got = keys(repaired)
        complete = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= size]
        assert set(got) <= whole
        assert len(got) == len(set(got))
        assert len(got) >= sum(c.message_index_length // 16 for c in complete) - 2 * len(complete)
        assert verify(repaired).intact


def test_a_sound_recording_is_repaired_to_the_same_messages(record: Any, tmp_path: Path) -> None:
    path = record()
    recovered = repair(path, tmp_path / "again.mcap")
    assert recovered.problems == []
    assert keys(tmp_path / "again.mcap") == keys(path)
    assert inspect(tmp_path / "again.mcap").attached == inspect(path).attached


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_a_damaged_block_costs_only_its_own_messages(
    record: Any, tmp_path: Path, compression: str
) -> None:
    path = record(compression=compression)
    whole = set(keys(path))
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    victim = chunks[len(chunks) // 2]
    start = victim.chunk_start_offset
    # A hole of zeros over the record's own length, as file systems leave after a power cut.
    data[start : start + victim.chunk_length] = bytes(victim.chunk_length)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(InputError):
        keys(damaged)
    recovered = repair(damaged, tmp_path / "repaired.mcap")
    assert recovered.problems
    got = set(keys(tmp_path / "repaired.mcap"))
    lost = sum(victim.message_index_offsets[c] > 0 for c in victim.message_index_offsets)
    assert lost == 1
    assert got < whole
    inside = [k for k in whole if victim.message_start_time <= k[1] <= victim.message_end_time]
    assert whole - got <= set(inside)


def test_repair_refuses_what_is_still_being_written(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    with pytest.raises(InputError, match="still being written"):
        repair(writer.unfinished, tmp_path / "other.mcap")
    writer.close({})


def test_repair_never_writes_over_a_file(record: Any, tmp_path: Path) -> None:
    path = record()
    before = path.read_bytes()
    with pytest.raises(InputError, match="never overwritten"):
        repair(path, path)
    assert path.read_bytes() == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)],
        capture_output=True,
        check=False,
    )
    if mounted.returncode != 0:
        pytest.skip("needs the right to mount a small tmpfs")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_disk_that_fills_is_told_of_and_the_recording_ended_before(
    small_disk: Path, python_environment: dict[str, str]
) -> None:
    process = started(small_disk, python_environment, stop_free=2 << 20, period_s=0.02)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert 0 < output.find("minutes, are left on the disk") < output.find("Recording has ended")
    numbers = [k[3] for k in keys(small_disk / "run.mcap")]
    assert numbers == list(range(1, len(numbers) + 1))
    assert verify(small_disk / "run.mcap").intact
    assert "full" in inspect(small_disk / "run.mcap").ended_because


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(65536))


def test_a_disk_that_others_fill_to_the_last_byte_ends_the_recording_soundly(
    small_disk: Path, python_environment: dict[str, str]
) -> None:
    process = started(small_disk, python_environment, stop_free=1)
    assert process.stdout is not None
    for _ in range(20):
        process.stdout.readline()
    with pytest.raises(OSError, match="No space left"):
        fill(small_disk / "other")
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "Recording has ended" in output
    numbers = [k[3] for k in keys(small_disk / "run.mcap")]
    assert len(numbers) >= 20
    assert numbers == list(range(1, len(numbers) + 1))
    assert verify(small_disk / "run.mcap").intact


def test_too_little_space_to_begin_with_is_refused(small_disk: Path) -> None:
    (small_disk / "other").write_bytes(bytes(12 << 20))
    with pytest.raises(InputError, match="free space"):
        RecordingWriter(small_disk / "run.mcap", RecordingOptions())
    assert [p.name for p in small_disk.iterdir()] == ["other"]


LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))\n" + WRITE_FOREVER


def test_a_file_that_may_not_grow_keeps_what_is_in_it(
    tmp_path: Path, python_environment: dict[str, str]
) -> None:
    """The index cannot be written either: the file stays unfinished, and `repair` reads it."""
    # The reserve itself is 16 MB.
    code = LIMITED.format(17 << 20)
    command = [sys.executable, "-c", code, str(tmp_path), "none", "1", "0.002"]
    done = subprocess.run(
        command, env=python_environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert "./omm repair" in done.stdout
    unfinished = tmp_path / f"run.mcap{UNFINISHED}"
    repair(unfinished, tmp_path / "run.mcap")
    numbers = [k[3] for k in keys(tmp_path / "run.mcap")]
    assert len(numbers) > 700
    assert numbers == list(range(1, len(numbers) + 1))


def test_a_folder_that_is_removed_is_told_of_and_made_again(
    tmp_path: Path, topics: Any, samples: Any
) -> None:
    folder = tmp_path / "run"
    told: list[str] = []
    writer = RecordingWriter(folder / "run.mcap", RecordingOptions())
    recorder = Recorder(writer, Limits(), told.append)
    recorder.add_topic(topics[1])
    poses = [s for s in samples if s.topic == topics[1].name]
    for s in poses:
        recorder.put(s.topic, s.data, s.sequence, s.log_ns, s.publish_ns)
    (folder / f"run.mcap{UNFINISHED}").unlink()
    folder.rmdir()
    until = time.monotonic() + 30.0
    while not told and time.monotonic() < until:
        time.sleep(0.05)
    assert "was removed" in told[0]
    assert keys(recorder.stop()) == [s.key for s in poses]


def test_a_disk_that_fails_is_told_of(
    tmp_path: Path, topics: Any, samples: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    recorder = Recorder(writer, Limits(), told.append)
    recorder.add_topic(topics[0])
    images = [s for s in samples if s.topic == topics[0].name]
    recorder.put(images[0].topic, images[0].data, 1, images[0].log_ns, images[0].publish_ns)
    until = time.monotonic() + 30.0
    while writer.counts().get(images[0].topic) != 1 and time.monotonic() < until:
        time.sleep(0.01)

    def broken(*_: object) -> int:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "writev", broken)
        recorder.put(images[1].topic, images[1].data, 2, images[1].log_ns, images[1].publish_ns)
        while recorder.state().recording and time.monotonic() < until:
            time.sleep(0.01)
        with pytest.raises(OmmError, match="could not be ended: Input/output error"):
            recorder.stop()
    assert "Input/output error" in told[0]
    repair(writer.unfinished, tmp_path / "run.mcap")
    assert keys(tmp_path / "run.mcap") == [images[0].key]
