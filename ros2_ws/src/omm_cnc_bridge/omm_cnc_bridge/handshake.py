"""The handshake with a measuring program: asked for an image, get it at true standstill, answer.

The program is answered only when the image is in *and* the spindle demonstrably stood still from
before the exposure until after it; otherwise the image is taken again. A request that cannot be
met is not answered: the program's own time-out then ends it, with the reason in the bridge's state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from omm_cnc_bridge.control import ControlSample
from omm_core.words import NOTHING, Words, keyed, sentences, verbatim


@dataclass(frozen=True, kw_only=True)
class HandshakeLimits:
    """How long and how often an image is tried for."""

    trigger_timeout_ns: int = 5_000_000_000
    attempts: int = 3
    retry_ns: int = 500_000_000
    """Pause after an attempt that failed."""
    hold_ns: int = 50_000_000
    """How long after the middle of the exposure the spindle must be seen to stand still."""


@dataclass(frozen=True, kw_only=True)
class Trigger:
    """Have an image taken; answer with ``Handshake.image``, giving ``attempt`` back."""

    attempt: int


@dataclass(frozen=True, kw_only=True)
class Acknowledge:
    """Tell the program that image ``request`` is in."""

    request: int
    image_ns: int = field(default=0, compare=False)
    """Stamp of that image."""


Action = Trigger | Acknowledge | None


class _Step(Enum):
    IDLE = keyed("said.step_idle", "no image asked for")
    SETTLING = keyed("said.step_settling", "waiting for standstill")
    EXPOSING = keyed("said.step_exposing", "waiting for the camera")
    HOLDING = keyed("said.step_holding", "waiting for the poses after the image")
    DONE = keyed("said.step_done", "answered")
    FAILED = keyed("said.step_failed", "given up")


class Handshake:
    """State machine; fed with every judged sample and with the camera's answers.

    Not safe for threads by itself: the caller holds a lock around it.

    Parameters
    ----------
    is_ready : callable
        Whether an image (its stamp, and now, ns) may be answered as far as others are concerned.
    """

    def __init__(
        self,
        limits: HandshakeLimits,
        is_ready: Callable[[int, int], bool] = lambda image_ns, now_ns: True,
    ) -> None:
        self._limits = limits
        self._is_ready = is_ready
        self._step = _Step.IDLE
        self._request: int | None = None
        self._attempt = 0  # counts over all requests, so that a late answer is recognised
        self._tries = 0
        self._not_before_ns = 0
        self._deadline_ns = 0
        self._image_ns = 0
        self.acknowledged = 0
        """Last request that was answered."""
        self.trouble = NOTHING
        """What went wrong with the present request; empty while nothing did."""

    @property
    def request(self) -> int | None:
        """The number of the image that is being taken; None between images."""
        return self._request

    @property
    def status(self) -> Words:
        """What is being waited for, with what went wrong so far."""
        step: Words = self._step.value
        return sentences([step, self.trouble]) if self.trouble else step

    def sample(self, sample: ControlSample, rest_since_ns: int | None, now_ns: int) -> Action:
        """Take in one judged sample.

        Parameters
        ----------
        rest_since_ns : int or None
            Since when the spindle has stood still, where it does (dwell included).
        """
        if sample.measure_request != self._request:
            self._begin(sample.measure_request)
        if self._step is _Step.SETTLING and rest_since_ns is not None:
            return self._trigger(now_ns) if now_ns >= self._not_before_ns else None
        if self._step is _Step.EXPOSING and now_ns > self._deadline_ns:
            late = keyed("said.camera_late", "the camera did not answer in time")
            self._failed(late, now_ns)
        if self._step is _Step.HOLDING:
            return self._hold(sample.stamp_ns, rest_since_ns, now_ns)
        return None

    def image(self, attempt: int, stamp_ns: int | None, message: str, now_ns: int) -> None:
        """Take in the camera's answer: the image's stamp, or None and why there is no image."""
        if self._step is not _Step.EXPOSING or attempt != self._attempt:
            return  # too late: that attempt was given up, or the program asks no more
        if stamp_ns is None:
            told = keyed("said.camera_says", "camera: {why}", why=verbatim(message))
            self._failed(told, now_ns)
        else:
            self._image_ns = stamp_ns
            self._step = _Step.HOLDING

    def refused(self, message: str, now_ns: int) -> None:
        """Note that the control did not take the acknowledgement, to try again."""
        if self._step is _Step.DONE:
            self.trouble = keyed(
                "said.not_acknowledged", "acknowledgement: {why}", why=verbatim(message)
            )
            self._step = _Step.HOLDING

    def _begin(self, request: int | None) -> None:
        self._request = request
        self._step = _Step.IDLE if request is None else _Step.SETTLING
        self._tries, self._not_before_ns, self.trouble = 0, 0, NOTHING

    def _trigger(self, now_ns: int) -> Trigger:
        self._attempt += 1
        self._tries += 1
        self._step = _Step.EXPOSING
        self._deadline_ns = now_ns + self._limits.trigger_timeout_ns
        return Trigger(attempt=self._attempt)

    def _hold(self, stamp_ns: int, rest_since_ns: int | None, now_ns: int) -> Action:
        if rest_since_ns is None or rest_since_ns > self._image_ns:
            moved = keyed("said.moved_exposing", "the spindle moved during the exposure")
            self._failed(moved, now_ns)
            return None
        if stamp_ns < self._image_ns + self._limits.hold_ns or self._request is None:
            return None
        if not self._is_ready(self._image_ns, now_ns):
            return None
        self._step = _Step.DONE
        self.acknowledged = self._request
        return Acknowledge(request=self._request, image_ns=self._image_ns)

    def _failed(self, why: Words, now_ns: int) -> None:
        self.trouble = keyed(
            "said.attempt",
            "{why} (attempt {n} of {most})",
            why=why,
            n=self._tries,
            most=self._limits.attempts,
        )
        self._not_before_ns = now_ns + self._limits.retry_ns
        self._step = _Step.SETTLING if self._tries < self._limits.attempts else _Step.FAILED
