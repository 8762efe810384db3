"""What becomes a pose and, above all, what does not."""

import dataclasses
import math
from pathlib import Path

import pytest

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.judgement import Judge, Reported, SampleLimits
from omm_cnc_bridge.standstill import StandStillLimits
from omm_core.machine.kinematics import Kinematics

MS = 1_000_000
MACHINES = Path(__file__).parents[1] / "machines"
LIMITS = SampleLimits(age_ns=500 * MS, stamp_uncertainty_ns=10 * MS)


def make_judge(machine: str = "three_axis_mill", **more) -> Judge:
    still = StandStillLimits(dwell_ns=100 * MS)
    return Judge(Kinematics.load(MACHINES / f"{machine}.urdf"), still, LIMITS, **more)


def sample(at_ms: float, **more) -> ControlSample:
    wanted = {"stamp_uncertainty_ns": MS, "positions": {"X": 1.0, "Y": 2.0, "Z": 3.0}, **more}
    return ControlSample(stamp_ns=round(at_ms * MS), **wanted)


def test_a_good_sample_becomes_a_pose_with_its_own_stamp():
    judged = make_judge().judge(sample(1000), 1010 * MS)
    assert judged.refused == ""
    assert judged.machine_T_spindle.translation_mm.tolist() == [1.0, 2.0, 3.0]
    assert judged.age_ns == 10 * MS


@pytest.mark.parametrize(
    ("change", "now_ms", "why"),
    [
        ({}, 1600, "late by 0.600 s"),
        ({}, 980, "0.020 s in the future"),
        ({"stamp_uncertainty_ns": 20 * MS}, 1000, "known to 20.0 ms only"),
        ({"fault": "axis X is not referenced"}, 1000, "axis X is not referenced"),
        ({"positions": {"X": 1.0, "Y": 2.0}}, 1000, "position of axis Z"),
        ({"positions": {"X": 1.0, "Y": 2.0, "Z": math.nan}}, 1000, "position of axis Z"),
    ],
)
def test_a_bad_sample_becomes_none(change, now_ms, why):
    judge = make_judge()
    judged = judge.judge(dataclasses.replace(sample(1000), **change), now_ms * MS)
    assert judged.machine_T_spindle is None
    assert why in judged.refused
    assert judged.rest_since_ns is None
    assert sum(judge.refusals.values()) == 1


def test_a_stamp_that_does_not_advance_is_refused():
    """What a dead control gives: the same values with the same stamp, again and again."""
    judge = make_judge()
    judge.judge(sample(1000), 1000 * MS)
    for now in (1010, 1020):
        assert "not after" in judge.judge(sample(1000), now * MS).refused


def test_a_refused_sample_ends_the_rest():
    judge = make_judge()
    for at in range(1000, 1201, 10):
        last = judge.judge(sample(at), at * MS)
    assert last.rest_since_ns == 1000 * MS
    judge.judge(sample(1210, fault="lost"), 1210 * MS)
    assert judge.judge(sample(1220), 1220 * MS).moving_reason == "first sample"


def test_a_tool_point_becomes_the_spindle():
    """B by 90° (worked by hand): the tool, 100 long, points to -X of the spindle's nose."""
    judge = make_judge("gantry_bc_head", reported=Reported.TOOL_POINT, tool_length_mm=100.0)
    tool_point = {"X": -350.0, "Y": 0.0, "Z": 250.0, "B": math.pi / 2, "C": 0.0}
    judged = judge.judge(sample(1000, positions=tool_point), 1000 * MS)
    assert judged.machine_T_spindle.translation_mm == pytest.approx([-250, 0, 250], abs=1e-9)
    assert judged.axes["X"] == pytest.approx(0.0, abs=1e-9)
