"""The recorder's bookkeeping: what is lost is counted and told, what is not is recorded."""

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from omm_core.errors import OmmError
from omm_recorder.counting import TopicTally
from omm_recorder.recorder import Recorder
from omm_recorder.recording_state import Limits
from omm_recording.inspecting import inspect
from omm_recording.writing import RecordingOptions, RecordingWriter


def wait_until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.005)


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def recorder(tmp_path: Path, topics: Any, told: list[str]) -> Recorder:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    recorder = Recorder(writer, Limits(queue_bytes=1 << 20), told.append)
    for topic in topics:
        recorder.add_topic(topic)
    return recorder


def put(recorder: Recorder, sample: Any, sequence: int | None = None) -> bool:
    number = sample.sequence if sequence is None else sequence
    return recorder.put(sample.topic, sample.data, number, sample.log_ns, sample.publish_ns)


def test_all_that_is_put_is_recorded_and_counted(
    recorder: Recorder, samples: Any, told: list[str]
) -> None:
    for sample in samples:
        wait_until(lambda: recorder.state().queue_bytes < 300_000)
        assert put(recorder, sample)
    summary = inspect(recorder.stop())
    assert told == []
    for topic in summary.topics:
        number = sum(s.topic == topic.name for s in samples)
        assert topic.messages == number
        assert topic.tally["received"] == topic.tally["recorded"] == number
        assert topic.tally["lost_by_recorder"] == topic.tally["missing_from_publisher"] == 0


def test_a_disk_that_does_not_keep_up_costs_whole_messages_and_is_told_at_once(
    recorder: Recorder, samples: Any, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    images = [s for s in samples if s.topic == "/camera/image_raw"]
    gate = threading.Event()
    write = RecordingWriter.write

    def slow(*arguments: Any, **named: Any) -> None:
        gate.wait()
        write(*arguments, **named)

    monkeypatch.setattr(RecordingWriter, "write", slow)
    taken = [put(recorder, image) for image in images]
    assert not all(taken)
    assert "the disk does not keep up" in told[0]
    gate.set()
    path = recorder.stop()
    tally = next(t for t in inspect(path).topics if t.name == "/camera/image_raw").tally
    assert tally["lost_by_recorder"] == taken.count(False) == recorder.state().lost
    assert tally["recorded"] == taken.count(True)


def test_messages_that_never_arrived_are_counted_by_the_publishers_numbers(
    recorder: Recorder, samples: Any, told: list[str]
) -> None:
    poses = [s for s in samples if s.topic == "/cnc/spindle_pose"]
    for sample, number in zip(poses, [7, 8, 12, 13]):
        put(recorder, sample, number)
    assert "3 messages on /cnc/spindle_pose never arrived" in told[0]
    tally = next(t for t in inspect(recorder.stop()).topics if "spindle" in t.name).tally
    assert tally["missing_from_publisher"] == 3
    assert tally["published_before_first"] == 6


def test_a_publisher_that_starts_again_is_no_loss() -> None:
    tally = TopicTally()
    assert [tally.see(n, n) for n in (1, 2, 3, 1, 2)] == [0] * 5
    assert tally.missing == 0


def test_two_publishers_on_a_topic_are_not_mistaken_for_losses() -> None:
    tally = TopicTally()
    for number in (1, 1, 2, 2, 3, 3):
        tally.see(number, 0)
    assert tally.missing is None


def test_the_longest_pause_is_noted() -> None:
    tally = TopicTally()
    for number, time_ns in enumerate((0, 10, 25, 30), 1):
        tally.see(number, time_ns)
    assert (tally.longest_pause_ns, tally.longest_pause_at_ns) == (15, 10)


def test_too_little_space_left_ends_the_recording_soundly(
    tmp_path: Path, topics: Any, samples: Any, told: list[str]
) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    limits = Limits(stop_free_bytes=1 << 60)
    recorder = Recorder(writer, limits, told.append)
    recorder.add_topic(topics[1])
    put(recorder, samples[0])
    wait_until(lambda: not recorder.state().recording)
    assert "Recording has ended" in told[0]
    assert not put(recorder, samples[1])
    assert recorder.state().lost == 1
    summary = inspect(recorder.stop())
    assert summary.ended_because == "the disk is full"
    assert summary.topics[0].messages == 1


def test_what_is_missing_at_the_end_is_counted_by_the_publishers_last_number() -> None:
    tally = TopicTally()
    for number in range(1, 101):
        tally.see(number, number)
    tally.announce(100, 1.0)
    assert tally.answered(0.5)
    assert not tally.answered(1.5)
    tally.announce(1300, 2.0)
    assert not tally.answered(1.5)
    tally.end(1.5)
    assert (tally.missing_at_end, tally.missing) == (1200, 1200)


def test_an_end_that_nobody_told_is_unknown_not_complete() -> None:
    tally = TopicTally()
    tally.see(1, 1)
    tally.announce(1, 1.0)
    tally.end(2.0)
    assert tally.missing_at_end is None
    assert json.loads(tally.as_text(1))["missing_at_end"] is None


def test_a_publisher_that_was_started_again_is_counted_by_its_new_numbers() -> None:
    tally = TopicTally()
    for number in range(1, 51):
        tally.see(number, number)
    tally.announce(50, 1.0)
    tally.announce(7, 2.0)  # a new life, of which nothing came
    tally.end(1.5)
    assert tally.missing_at_end == 7


def test_what_was_published_before_the_recorder_came_is_not_missing() -> None:
    tally = TopicTally()
    tally.announce(40, 1.0)
    assert tally.answered(0.0)
    tally.announce(42, 2.0)
    tally.end(1.5)
    assert tally.missing_at_end == 2


def test_whatever_ends_the_writing_thread_is_told_and_what_was_written_is_kept(
    recorder: Recorder, samples: Any, told: list[str]
) -> None:
    assert put(recorder, samples[0])
    wait_until(lambda: recorder.state().queue_bytes == 0)

    def breaks(writer: RecordingWriter) -> None:
        raise KeyError("a defect")

    recorder._enqueue(0, breaks)
    wait_until(lambda: not recorder.state().recording)
    assert "KeyError" in recorder.state().trouble
    assert any("KeyError" in text for text in told)
    assert not put(recorder, samples[1])
    summary = inspect(recorder.stop())
    assert sum(topic.messages or 0 for topic in summary.topics) == 1


def test_a_recording_that_cannot_be_closed_is_an_error_for_who_stops_it(
    recorder: Recorder, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def close(report: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr(recorder._writer, "close", close)
    with pytest.raises(OmmError, match="could not be closed: RuntimeError: a defect"):
        recorder.stop()
    assert any("could not be closed" in text for text in told)
