"""The simulated touch probe finds the part where that machine, by its own scales, meets it."""

from dataclasses import replace

import numpy as np
import pytest

from omm_core.budget.probing import check_probing
from omm_core.errors import InputError
from omm_core.files.probed import ProbedPoint
from omm_simulation.cell import draw
from omm_simulation.machine_errors import MachineErrors
from omm_simulation.probe import cell_of, touch
from omm_simulation.scenario import load_scenario

POINTS = [
    ProbedPoint(name=f"{x} {y}", part_mm=np.array([x, y, 0.0]), machine_mm=None)
    for x in (0.0, 750.0, 1500.0)
    for y in (0.0, 1000.0)
]


def test_an_exact_machine_finds_the_true_pose() -> None:
    cell = draw(load_scenario("ideal"), 3)
    check = check_probing(touch(cell, POINTS), list(cell.theta().values()), np.zeros((6, 6)))
    assert check.share_inside > 0.8
    assert check.error_mm == pytest.approx(0.0, abs=0.005)


def test_own_coordinates_fit_what_the_probe_finds_better_than_absolute_ones() -> None:
    exact = load_scenario("ideal")
    errors = MachineErrors(geometry_sigma_mm=0.05, geometry_length_mm=1500.0)
    own, absolute = [], []
    for seed in range(20):
        cell = draw(replace(exact, errors=errors), seed)
        touched = touch(cell, POINTS)
        for found, theta in ((own, cell.theta_own()), (absolute, cell.theta())):
            check = check_probing(touched, list(theta.values()), np.zeros((6, 6)))
            found.append(np.sqrt(np.mean(check.error_mm**2)))
    assert np.mean(own) < 0.5 * np.mean(absolute)


def test_a_warm_part_is_touched_where_it_is() -> None:
    exact = load_scenario("ideal")
    errors = MachineErrors(part_warmth_K=20.0)
    cell = draw(replace(exact, errors=errors), 5)
    check = check_probing(touch(cell, POINTS), list(cell.theta().values()), np.zeros((6, 6)))
    grown = 11e-6 * cell.errors.part_warmth_K * np.array([p.part_mm for p in POINTS])
    assert check.error_mm == pytest.approx(grown, abs=0.02)


def test_a_run_that_is_not_simulated_cannot_be_touched(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match="truth"):
        cell_of(tmp_path / "truth.json")
    (tmp_path / "truth.json").write_text('{"scenario": "ideal", "seed": "x"}')
    with pytest.raises(InputError, match="seed"):
        cell_of(tmp_path / "truth.json")
