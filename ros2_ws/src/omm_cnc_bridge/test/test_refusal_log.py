"""Refusals that go on stand in the log, and do not fill it."""

from omm_cnc_bridge.refusal_log import RefusalLog


def lines(refusals):
    log = RefusalLog()
    told = [log.hear(why, now_s) for now_s, why in refusals]
    return [line for line in told if line]


def test_refusals_that_go_on_are_told_once_in_a_while_with_the_reason():
    told = lines((0.01 * i, "axis W is reported") for i in range(4000))
    assert len(told) == 2
    assert "axis W is reported" in told[0]


def test_refusals_between_poses_are_not_told():
    assert lines((0.01 * i, "late" if i % 100 else "") for i in range(4000)) == []
