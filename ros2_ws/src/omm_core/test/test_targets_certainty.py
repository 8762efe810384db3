"""A small run of bench/targets_certainty.py: no wrong number, and hardly one missed."""

import importlib
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[4] / "bench"


@pytest.fixture
def certainty(monkeypatch):
    if not BENCH.is_dir():
        pytest.skip("bench/ is not part of this installation")
    monkeypatch.syspath_prepend(str(BENCH))
    return importlib.import_module("targets_certainty")


def test_no_number_is_wrong_where_nothing_is_covered(certainty):
    result = certainty.count(150, seed=11)
    assert result["wrong"] == 0
    assert result["easy"] > 40
    assert result["easy right"] >= 0.97 * result["easy"]


def test_covered_rings_do_not_pass_for_another_of_a_proposed_set(certainty):
    result = certainty.count(80, covered=True, chosen=10, seed=12)
    assert result["wrong in set"] == 0
    assert result["right"] > 0
