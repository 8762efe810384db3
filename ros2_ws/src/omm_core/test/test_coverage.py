"""Errors lie inside U as often as U says; a small part of what bench/coverage.py measures."""

import numpy as np
import pytest
from core_coverage import ABSOLUTE, OWN, WRONGS, CoverageCell, all_cells, draw, finds, measure

RUNS = 150


def tally(cell):
    tallies = [measure(cell, seed) for seed in range(RUNS)]
    return sum(tallies[1:], tallies[0])


def test_a_solver_that_knows_all_noise_is_right_in_9545_of_10000_cases():
    """What every width is compared with, on a machine with everything: 2800 errors, ± 3 σ."""
    cell = CoverageCell(stop_um=3.0, geometry_um=15.0, target_um=20.0, distance_mm=150)
    drawn = [draw(cell, np.random.default_rng([7, k])) for k in range(200)]
    errors = np.array([[d.best.own - d.own, d.best.absolute - d.absolute] for d in drawn])
    sigmas = np.sqrt([
        [np.diag(d.best.own_covariance), np.diag(d.best.absolute_covariance)] for d in drawn
    ])  # fmt: skip
    inside = np.abs(errors) < 2.0 * sigmas
    # Parameters of one run are correlated: as if each run were one or two of them.
    assert np.all(np.abs(inside.mean(axis=(0, 2)) - 0.9545) < 3 * np.sqrt(0.0434 / 200 / 2))
    assert np.all(np.abs(np.mean((errors / sigmas) ** 2, axis=0) - 1.0) < 0.5)


def test_where_only_the_image_is_noisy_u_is_as_wide_as_it_must_be():
    found = tally(CoverageCell(stop_um=0.0, geometry_um=0.0))
    assert found.refused == 0
    assert found.lost <= 2
    assert np.all(found.inside[[OWN, ABSOLUTE]] / RUNS > 0.90)
    assert np.all(found.widths.mean(axis=0)[OWN] > 0.98)


@pytest.mark.parametrize(
    ("stop_um", "geometry_um", "correlation"), [(3.0, 15.0, 0.4), (8.0, 0.0, 1.0)]
)
def test_on_machines_as_they_are_errors_lie_inside_u_and_u_is_not_wide(
    stop_um, geometry_um, correlation
):
    """150 runs: a share of 95 % is known to ± 1.8 %, over all parameters to about ± 1 %."""
    found = tally(
        CoverageCell(
            stop_um=stop_um, geometry_um=geometry_um, correlation=correlation, distance_mm=150
        )
    )
    assert found.refused == 0
    assert found.lost <= 5
    for statement in (OWN, ABSOLUTE):
        inside = found.inside[statement] / RUNS
        assert inside.min() > 0.87
        assert inside.mean() > 0.92
        assert np.mean(found.widths[:, statement]) < 2.2


@pytest.mark.parametrize("wrong", WRONGS)
def test_what_is_wrong_on_an_exact_machine_is_found_and_named(wrong):
    cell = CoverageCell(stop_um=0.0, geometry_um=0.0, targets=6)
    assert sum(finds(cell, wrong, seed) for seed in range(10)) >= 9


@pytest.mark.parametrize("wrong", WRONGS)
def test_what_is_wrong_on_a_machine_as_they_are_is_found_and_named(wrong):
    cell = CoverageCell(stop_um=4.0, geometry_um=15.0, targets=4)
    assert sum(finds(cell, wrong, seed) for seed in range(20)) >= 17


def test_every_cell_of_the_table_has_its_own_name():
    names = [cell.name for cell in all_cells()]
    assert len(set(names)) == len(names)
    assert len(names) > 200
