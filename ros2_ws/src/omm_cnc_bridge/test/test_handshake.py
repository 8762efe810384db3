"""The handshake: an answer only for an image that was taken at rest."""

import pytest

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.handshake import Acknowledge, Handshake, HandshakeLimits, Trigger

MS = 1_000_000
LIMITS = HandshakeLimits(
    trigger_timeout_ns=1000 * MS, attempts=2, retry_ns=100 * MS, hold_ns=50 * MS
)


class Bench:
    """Feeds a handshake with samples 10 ms apart and records what it wants."""

    def __init__(self) -> None:
        self.handshake = Handshake(LIMITS)
        self.now_ms = 0

    def feed(self, ms: int, request: int | None, rest_since_ms: int | None) -> list[object]:
        wanted = []
        for _ in range(0, ms, 10):
            self.now_ms += 10
            sample = ControlSample(
                stamp_ns=self.now_ms * MS,
                stamp_uncertainty_ns=0,
                positions={},
                measure_request=request,
            )
            since = None if rest_since_ms is None else rest_since_ms * MS
            action = self.handshake.sample(sample, since, self.now_ms * MS)
            if action is not None:
                wanted.append(action)
        return wanted

    def answer(self, attempt: int, image_ms: int | None, message: str = "") -> None:
        image_ns = None if image_ms is None else image_ms * MS
        self.handshake.image(attempt, image_ns, message, self.now_ms * MS)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_happens_without_a_request(bench):
    assert bench.feed(1000, None, 0) == []


def test_triggered_once_at_rest_and_answered_after_the_hold(bench):
    assert bench.feed(100, 7, None) == []
    assert bench.feed(100, 7, 0) == [Trigger(attempt=1)]
    bench.answer(1, image_ms=bench.now_ms - 5)
    assert bench.feed(40, 7, 0) == []
    assert bench.feed(100, 7, 0) == [Acknowledge(request=7)]
    assert bench.handshake.acknowledged == 7
    assert bench.feed(100, None, 0) == []


def test_an_image_taken_in_motion_is_taken_again(bench):
    assert bench.feed(10, 1, 0) == [Trigger(attempt=1)]
    bench.answer(1, image_ms=bench.now_ms)
    assert bench.feed(20, 1, None) == []
    assert "moved during the exposure" in bench.handshake.trouble
    assert bench.feed(200, 1, bench.now_ms) == [Trigger(attempt=2)]
    bench.answer(2, image_ms=bench.now_ms)
    assert bench.feed(100, 1, bench.now_ms - 100) == [Acknowledge(request=1)]


def test_rest_that_began_after_the_image_does_not_count(bench):
    bench.feed(10, 1, 0)
    bench.answer(1, image_ms=bench.now_ms)
    assert bench.feed(100, 1, bench.now_ms + 1) == []
    assert "moved" in bench.handshake.trouble


def test_a_camera_that_fails_is_asked_again_and_then_told_not_answered(bench):
    assert bench.feed(10, 1, 0) == [Trigger(attempt=1)]
    bench.answer(1, None, "no cable")
    assert bench.feed(90, 1, 0) == []
    assert bench.feed(20, 1, 0) == [Trigger(attempt=2)]
    bench.answer(2, None, "no cable")
    assert bench.feed(5000, 1, 0) == []
    assert "given up; camera: no cable (attempt 2 of 2)" in bench.handshake.status
    assert bench.handshake.acknowledged == 0


def test_a_silent_camera_is_a_failed_attempt_and_its_late_answer_is_not_used(bench):
    assert bench.feed(10, 1, 0) == [Trigger(attempt=1)]
    assert bench.feed(1200, 1, 0) == [Trigger(attempt=2)]
    bench.answer(1, image_ms=bench.now_ms)
    assert bench.feed(100, 1, 0) == []
    bench.answer(2, image_ms=bench.now_ms)
    assert bench.feed(100, 1, 0) == [Acknowledge(request=1)]


def test_a_request_that_is_withdrawn_is_forgotten(bench):
    bench.feed(10, 1, 0)
    bench.feed(10, None, 0)
    bench.answer(1, image_ms=bench.now_ms)
    assert bench.feed(100, None, 0) == []
    assert bench.handshake.acknowledged == 0


def test_the_same_number_can_be_asked_for_again(bench):
    for attempt in (1, 2):
        assert bench.feed(10, 1, 0) == [Trigger(attempt=attempt)]
        bench.answer(attempt, image_ms=bench.now_ms)
        assert bench.feed(100, 1, 0) == [Acknowledge(request=1)]
        bench.feed(10, None, 0)


def test_an_acknowledgement_that_is_refused_is_tried_again(bench):
    bench.feed(10, 1, 0)
    bench.answer(1, image_ms=bench.now_ms)
    assert bench.feed(100, 1, 0) == [Acknowledge(request=1)]
    bench.handshake.refused("busy", bench.now_ms * MS)
    assert bench.feed(20, 1, 0) == [Acknowledge(request=1)]
