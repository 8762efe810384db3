"""Lengths are accepted by the limit that grows with them, and what the test lacks is said."""

import pytest

from omm_core.errors import MeasurementError
from omm_core.survey.acceptance import CalibratedLength, accept, as_json

LENGTHS = [CalibratedLength(ends=(1, i), length_mm=200.0 * i) for i in range(2, 7)]


def measured(errors):
    return lambda ends: None if ends[1] not in errors else (200.0 * ends[1] + errors[ends[1]], 0.01)


def test_a_longer_length_may_err_more():
    errors = {i: 0.06 for i in range(2, 7)}
    result = accept(LENGTHS, measured(errors), 1000.0, 0.05, 0.02)
    assert [length.within for length in result.lengths] == [False, True, True, True, True]
    assert not result.passed
    assert accept(LENGTHS, measured(dict.fromkeys(errors, -0.05)), 1000.0, 0.05, 0.02).passed


def test_what_goes_into_the_budget_is_the_limit_over_root_three():
    result = as_json(accept(LENGTHS, measured({6: 0.01}), 1000.0, 0.05, 0.02))
    assert result["u_out_mm"] == pytest.approx((0.05 + 0.02 * 1.2) / 3**0.5)
    assert result["largest_error_mm"] == pytest.approx(0.01)


def test_too_few_and_too_short_lengths_are_told_and_none_is_no_test():
    words = accept(LENGTHS, measured({2: 0.0}), 1000.0, 0.05, 0.02).words
    assert len(words) == 3
    assert "35" in words[1]
    assert "two thirds" in words[2]
    with pytest.raises(MeasurementError, match="none"):
        accept(LENGTHS, measured({}), 1000.0, 0.05, 0.02)
