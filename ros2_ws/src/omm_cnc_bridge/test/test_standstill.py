"""Standing still: all three of word, command and dwell are needed, and none is enough."""

import dataclasses
import math

import pytest

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.standstill import StandStill, StandStillLimits

MS = 1_000_000
LIMITS = StandStillLimits(tolerance_mm=0.005, tolerance_rad=5e-6, dwell_ns=100 * MS, gap_ns=50 * MS)


def sample(at_ms: float, x: float = 0.0, **more) -> ControlSample:
    wanted = {"positions": {"X": x}, "commanded": {"X": 0.0}, "in_position": True, **more}
    return ControlSample(stamp_ns=round(at_ms * MS), stamp_uncertainty_ns=0, **wanted)


def judge(samples) -> list[str]:
    still = StandStill(LIMITS, frozenset({"B"}))
    return [still.update(s) for s in samples]


def test_still_only_after_the_dwell():
    told = judge(sample(t) for t in range(0, 151, 10))
    assert [bool(reason) for reason in told] == [t < 100 for t in range(0, 151, 10)]
    assert "0.050 of 0.100 s" in told[5]


def test_a_servo_that_lags_is_not_in_position_when_the_control_says_so():
    """The command has arrived and the control says so; the axis follows with 20 ms."""
    told = judge(sample(t, x=-0.38 * math.exp(-t / 20)) for t in range(0, 400, 10))
    first = told.index("") * 10
    arrived = 20 * math.log(0.38 / 0.005)
    assert first >= arrived + 100
    assert "X is 0.3800 mm away from its command" in told[0]


def test_the_controls_word_is_needed():
    told = judge(sample(t, in_position=False) for t in range(0, 300, 10))
    assert set(told) == {"control: not in position"}


def test_a_control_without_a_word_and_command_is_judged_by_its_rest():
    told = judge(sample(t, in_position=None, commanded={}) for t in range(0, 151, 10))
    assert told[-1] == ""
    assert told[5] != ""


def test_creeping_is_moving():
    """0.2 mm/s: less than the tolerance from sample to sample, more than it over the dwell."""
    told = judge(sample(t, x=0.0002 * t, commanded={}) for t in range(0, 1000, 10))
    assert all(told)


def test_a_gap_starts_the_dwell_anew():
    told = judge(sample(t) for t in [*range(0, 151, 10), *range(250, 401, 10)])
    assert told[15] == ""
    assert "gap of 0.100 s" in told[16]
    assert [bool(reason) for reason in told[16:]] == [t < 350 for t in range(250, 401, 10)]


def test_rotary_axes_have_their_own_tolerance():
    turned = sample(0, positions={"B": 1e-5}, commanded={"B": 0.0})
    assert "B is 0.0100 mrad away" in judge([turned])[0]


@pytest.mark.parametrize("positions", [{"X": math.nan}, {}])
def test_an_undefined_position_is_not_still(positions):
    told = judge(sample(t, positions=positions) for t in range(0, 300, 10))
    assert all(told)


def test_a_fault_overrules_everything():
    good = [sample(t) for t in range(0, 151, 10)]
    told = judge([*good, dataclasses.replace(sample(160), fault="X is not referenced")])
    assert told[-2:] == ["", "X is not referenced"]
