"""Time goes on as it was recorded: faster, slower, not at all, or message by message."""

import os
import pty
import threading
from collections.abc import Iterator

import pytest

from omm_recorder.keyboard import RIGHT, SPACE, UP, Keyboard
from omm_recorder.playback import PlaybackClock

pytest.importorskip("rclpy", reason="ROS 2 is not there")

from omm_recorder.reading_ahead import read_ahead

S = 1_000_000_000


class Wall:
    """A wall clock that goes when told."""

    def __init__(self) -> None:
        self.time_s = 100.0

    def __call__(self) -> float:
        return self.time_s


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_a_message_is_due_after_its_time_over_the_rate(wall: Wall, rate: float) -> None:
    clock = PlaybackClock(10 * S, rate=rate, now_s=wall)
    assert clock.wait_s(12 * S) == pytest.approx(2.0 / rate)
    wall.time_s += 2.0 / rate
    assert clock.wait_s(12 * S) == pytest.approx(0.0)
    assert clock.now_ns() == pytest.approx(12 * S)


def test_what_is_late_is_due_at_once(wall: Wall) -> None:
    clock = PlaybackClock(10 * S, now_s=wall)
    wall.time_s += 5.0
    assert clock.wait_s(12 * S) == 0.0


def test_no_time_passes_in_a_pause(wall: Wall) -> None:
    clock = PlaybackClock(10 * S, now_s=wall)
    wall.time_s += 1.0
    clock.toggle_pause()
    wall.time_s += 50.0
    assert clock.wait_s(12 * S) is None
    assert clock.now_ns() == 11 * S
    clock.toggle_pause()
    assert clock.wait_s(12 * S) == pytest.approx(1.0)


def test_a_step_plays_one_message_and_stands_there(wall: Wall) -> None:
    clock = PlaybackClock(10 * S, paused=True, now_s=wall)
    clock.step()
    assert clock.wait_s(12 * S) == 0.0
    clock.played(12 * S)
    assert clock.wait_s(13 * S) is None
    assert clock.now_ns() == 12 * S


def test_changing_the_rate_does_not_jump(wall: Wall) -> None:
    clock = PlaybackClock(0, now_s=wall)
    wall.time_s += 1.0
    clock.change_rate(2.0)
    assert clock.now_ns() == pytest.approx(1 * S)
    wall.time_s += 1.0
    assert clock.now_ns() == pytest.approx(3 * S)


def test_keys_come_without_enter_and_the_terminal_is_left_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import sys
    import termios

    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp())
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with Keyboard() as keys:
            assert keys.present
            assert keys.key(0.0) is None
            for key in (SPACE, RIGHT, UP):
                os.write(ours, key.encode())
                assert keys.key(5.0) == key
        assert termios.tcgetattr(theirs) == before
    os.close(ours)


def test_without_a_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with Keyboard() as keys:
            assert not keys.present
            assert keys.key(0.0) is None


def test_a_defect_while_reading_ahead_ends_the_replay_instead_of_keeping_it_waiting() -> None:
    def messages() -> Iterator[object]:
        yield "first"
        raise KeyError("a defect")

    taken = read_ahead(messages(), threading.Event())  # type: ignore[arg-type]
    assert next(taken) == "first"
    with pytest.raises(KeyError, match="a defect"):
        next(taken)
