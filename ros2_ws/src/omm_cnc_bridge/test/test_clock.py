"""The clock relation: right within what it says of itself, whatever the transport does."""

import numpy as np
import pytest

from omm_cnc_bridge.clock import ControlClock

MS, S = 1_000_000, 1_000_000_000


class Transport:
    """A control's clock with offset and drift, heard through a random delay."""

    def __init__(self, *, drift: float = 0.0, seed: int = 1) -> None:
        self.drift, self.offset_ns = drift, 5 * S
        self._random = np.random.default_rng(seed)

    def control_ns(self, true_ns: int) -> int:
        return round((true_ns - self.offset_ns) * (1 + self.drift))

    def delay_ns(self) -> int:
        return round(self._random.exponential(3 * MS))


def errors(clock: ControlClock, transport: Transport, start_s: float, end_s: float):
    """Error and claimed standard deviation of each mapped stamp, ns, shape (n, 2)."""
    out = []
    for true_ns in range(round(start_s * S), round(end_s * S), 10 * MS):
        ours, sigma = clock.observe(transport.control_ns(true_ns), true_ns + transport.delay_ns())
        out.append((ours - true_ns, sigma))
    return np.array(out)


@pytest.mark.parametrize("drift", [0.0, 200e-6, -200e-6])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_error_is_within_what_the_clock_says(drift, seed):
    found = errors(ControlClock(), Transport(drift=drift, seed=seed), 100, 190)
    settled = found[500:]
    assert np.abs(settled[:, 0]).max() < 1.0 * MS
    assert np.mean(np.abs(settled[:, 0]) <= 3 * settled[:, 1]) > 0.99
    assert np.mean(np.abs(found[:500, 0]) <= 3 * found[:500, 1]) > 0.99


def test_drift_is_found():
    clock = ControlClock()
    errors(clock, Transport(drift=200e-6), 100, 140)
    assert clock.relation is not None
    # Control time runs fast by 200 ppm, so ours per theirs is slow by as much.
    assert clock.relation.drift == pytest.approx(-200e-6, abs=20e-6)


@pytest.mark.parametrize("jump_ns", [3600 * S, 40 * MS, -3600 * S, -40 * MS])
def test_a_jump_is_noticed_at_once(jump_ns):
    clock, transport = ControlClock(), Transport(drift=200e-6)
    errors(clock, transport, 100, 140)
    transport.offset_ns -= jump_ns
    after = errors(clock, transport, 140, 150)
    assert clock.jumps == 1
    assert np.mean(np.abs(after[:, 0]) <= 3 * after[:, 1]) > 0.99
    assert np.abs(after[-100:, 0]).max() < 1.5 * MS


def test_late_samples_do_not_move_the_clock():
    """A network that hangs for 3 s delivers old samples all at once: they keep their old stamps."""
    clock, transport = ControlClock(), Transport()
    errors(clock, transport, 100, 130)
    for true_ns in range(130 * S, 133 * S, 10 * MS):
        ours, _ = clock.observe(transport.control_ns(true_ns), 133 * S + transport.delay_ns())
        assert abs(ours - true_ns) < 1 * MS
    assert clock.jumps == 0
    assert np.abs(errors(clock, transport, 133, 140)[:, 0]).max() < 1 * MS


def test_a_clock_that_has_just_started_admits_it():
    clock, transport = ControlClock(start_uncertainty_ns=20 * MS), Transport()
    _, sigma = clock.observe(transport.control_ns(100 * S), 100 * S + transport.delay_ns())
    assert sigma >= 10 * MS


def test_the_least_delay_is_taken_off():
    clock = ControlClock(least_delay_ns=2 * MS)
    found = [clock.observe(t, t + 2 * MS) for t in range(100 * S, 110 * S, 10 * MS)]
    assert found[-1][0] == 110 * S - 10 * MS
