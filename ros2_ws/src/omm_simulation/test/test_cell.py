"""Laws of scenarios and of the cells drawn from them."""

import dataclasses
import json

import numpy as np
import pytest
import yaml

from omm_core.errors import InputError
from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_simulation.cell import draw, write_estimator_files, write_truth
from omm_simulation.machine_errors import MachineErrors
from omm_simulation.scenario import load_scenario, scenario_folder, scenario_names

THETA = ["alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm", "gamma_s_rad"]


def test_the_scenarios_of_the_contract_are_there():
    assert {"bench", "industrial", "ideal"} <= set(scenario_names())


@pytest.mark.parametrize("name", scenario_names())
def test_a_scenario_is_found_by_name_by_folder_and_by_file(name):
    folder = scenario_folder() / name
    for way in (name, folder, folder / "scenario.yaml"):
        assert load_scenario(way).name == name


def test_bench_is_the_papers_test_bench():
    scenario = load_scenario("bench")
    xy = np.array([t.xyz_mm[:2] for t in scenario.part.targets])
    assert sorted(map(tuple, xy)) == [(0, 0), (0, 1000), (1500, 0), (1500, 1000)]
    assert scenario.backlash_rad == 6.15e-3
    cell = draw(scenario, 7)
    assert [stop.target_id for stop in cell.stops] == [42, 42, 40, 40, 8, 8, 122, 122]
    for first, second in zip(cell.stops[::2], cell.stops[1::2]):
        base = second.spindle_in_machine_mm - first.spindle_in_machine_mm
        assert np.linalg.norm(base) == pytest.approx(120.0, abs=2.5)


def test_industrial_targets_span_10_by_3_m_in_xz():
    scenario = load_scenario("industrial")
    xyz = np.array([t.xyz_mm for t in scenario.part.targets])
    np.testing.assert_allclose(np.ptp(xyz, axis=0)[[0, 2]], [10000.0, 3000.0])
    assert np.ptp(xyz[:, 1]) < 10.0


@pytest.mark.parametrize("name", scenario_names())
def test_equal_seeds_make_equal_cells_and_different_seeds_different_ones(name):
    scenario = load_scenario(name)
    one, same, other = (draw(scenario, seed) for seed in (3, 3, 4))
    assert one.theta() == same.theta()
    for key in THETA:
        assert one.theta()[key] != other.theta()[key]
    for a, b in zip(one.stops, same.stops):
        np.testing.assert_array_equal(a.spindle_in_machine_mm, b.spindle_in_machine_mm)


def test_a_new_clamping_changes_the_clamping_angle_alone():
    scenario = load_scenario("bench")
    theta, again = draw(scenario, 3).theta(), draw(scenario, 3, clamping_seed=8).theta()
    assert [key for key in THETA if theta[key] != again[key]] == ["gamma_s_rad"]


def erring(**sizes):
    return dataclasses.replace(load_scenario("bench"), errors=MachineErrors(**sizes))


def test_without_errors_of_the_geometry_own_truth_is_absolute():
    cell = draw(erring(stop_sigma_mm=0.01, lost_motion_mm=(0.01, 0.01, 0.01)), 3)
    assert cell.theta_own() == cell.theta()


def test_own_truth_is_absolute_but_for_what_the_geometry_does_at_the_targets():
    cell = draw(erring(geometry_sigma_mm=0.02, geometry_length_mm=1e7), 3)
    # Errors of endless wavelength shift the whole machine.
    shift = cell.geometry_at_stops_mm().mean(axis=0)
    own, absolute = (np.array(list(t.values())) for t in (cell.theta_own(), cell.theta()))
    np.testing.assert_allclose((own - absolute)[3:6], -shift, atol=1e-4)
    np.testing.assert_allclose((own - absolute)[:3], 0.0, atol=1e-8)
    assert own[6] == absolute[6]
    assert np.linalg.norm(shift) > 0.005


def test_a_machine_errs_the_same_in_every_clamping():
    scenario = erring(geometry_sigma_mm=0.02, part_warmth_K=1.0, holder_sigma_mm=(0.01, 0.01, 0.0))
    one, other = draw(scenario, 3), draw(scenario, 3, clamping_seed=9)
    np.testing.assert_array_equal(one.geometry_at_stops_mm(), other.geometry_at_stops_mm())
    assert one.errors.part_warmth_K == other.errors.part_warmth_K
    seats = [
        c.true_calibration.taper_T_camera.translation_mm
        - scenario.calibration.taper_T_camera.translation_mm
        for c in (one, other)
    ]
    assert np.all(seats[0][:2] != seats[1][:2])
    np.testing.assert_array_equal([seat[2] for seat in seats], 0.0)


@pytest.mark.parametrize("name", scenario_names())
def test_cameras_as_clamped_err_by_what_their_file_declares(name):
    """Calibration (by the cell's seed) and seat (by the clamping's) together."""
    scenario = load_scenario(name)
    told, names = scenario.calibration, scenario.calibration.parameters
    drawn = np.array(
        [draw(scenario, seed).true_calibration.parameter_values(names) for seed in range(400)]
    ).reshape(400, -1)
    errors = drawn - told.parameter_values(names)
    sigma = np.sqrt(np.diag(told.covariance))
    np.testing.assert_allclose(errors.std(axis=0), sigma, rtol=4.5 / (2 * 400) ** 0.5)


def test_a_warm_part_is_larger():
    cell = draw(erring(part_warmth_K=2.0), 3)
    told, true = ([t.xyz_mm for t in p.targets] for p in (cell.scenario.part, cell.true_part))
    grown = 1.0 + cell.errors.part_warmth_K * 11e-6
    np.testing.assert_allclose(true, np.array(told) * grown, rtol=1e-12)
    assert 0.0 < abs(cell.errors.part_warmth_K) <= 2.0


def test_the_truth_tells_all_that_is_not_as_it_seems():
    cell = draw(erring(stop_sigma_mm=0.003, geometry_sigma_mm=0.02), 3)
    truth = json.loads(json.dumps(cell.truth()))
    assert list(truth["theta_own"]) == THETA
    assert truth["theta_own"] != truth["theta"]
    assert truth["machine"]["stop_sigma_mm"] == 0.003
    assert len(truth["machine"]["geometry_at_stops_mm"]) == len(cell.stops)


@pytest.mark.parametrize("sizes", [
    {"stop_sigma_mm": -1.0}, {"geometry_sigma_mm": 0.1, "geometry_length_mm": 0.0},
    {"lost_motion_mm": (0.0, -0.1, 0.0)},
])  # fmt: skip
def test_errors_that_cannot_be_are_refused(sizes):
    with pytest.raises(InputError, match="Expected errors >= 0"):
        MachineErrors(**sizes)


def test_clamping_is_uniform_over_the_backlash():
    scenario = load_scenario("bench")
    angles = np.array([draw(scenario, 0, clamping_seed=s).gamma_s_rad for s in range(300)])
    half = scenario.backlash_rad / 2
    assert np.all(np.abs(angles) <= half)
    assert angles.min() < -0.95 * half
    assert angles.max() > 0.95 * half
    # Standard deviation of a uniform distribution; 4 σ of its own spread for 300 draws.
    assert angles.std() == pytest.approx(half / 3**0.5, rel=4 * 0.45 / 300**0.5)


def test_the_estimator_is_given_the_part_and_the_camera_and_nothing_else(tmp_path):
    scenario = dataclasses.replace(load_scenario("industrial"), errors=MachineErrors())
    cell = draw(scenario, 5, bumped_id=40)
    part_file, calibration_file = write_estimator_files(cell, tmp_path / "run")
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == ["camera.yaml", "part.yaml"]
    assert load_calibration(calibration_file).lens == cell.scenario.calibration.lens
    told = load_part(part_file)
    assert [t.id for t in told.targets] == [t.id for t in cell.scenario.part.targets]
    # The bump is known to nobody.
    moved = {
        t.id
        for t, true in zip(told.targets, cell.true_part.targets)
        if np.any(t.xyz_mm != true.xyz_mm)
    }
    assert moved == {40}


def test_the_truth_has_the_form_of_the_contract(tmp_path):
    cell = draw(load_scenario("bench"), 7)
    write_truth(cell, tmp_path / "truth.json")
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert list(truth["theta"]) == THETA
    assert truth["theta"] == cell.theta()
    assert truth["scenario"] == "bench"
    assert truth["seed"] == 7
    assert truth["bumped_id"] is None


def copied_scenario(folder, **changes):
    source = scenario_folder() / "bench"
    document = yaml.safe_load((source / "scenario.yaml").read_text())
    document.update(changes)
    for name in ("part.yaml", "camera.yaml"):
        (folder / name).write_text((source / name).read_text())
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def test_a_users_own_scenario_is_read(tmp_path):
    path = copied_scenario(tmp_path, name="mine", backlash_rad=0.0)
    cell = draw(load_scenario(path), 1)
    assert cell.scenario.name == "mine"
    assert cell.gamma_s_rad == 0.0


@pytest.mark.parametrize(("changes", "message"), [
    ({"imaging": {"exposure": 1.0}}, "'exposure' is not known. Did you mean exposure_s"),
    ({"program": {"distance_mm": 300.0}}, "stereo_base_mm"),
    ({"placement": {"translation_mm": [1, 2], "translation_range_mm": [0, 0, 0]}}, "3 numbers"),
    ({"part_file": "nowhere.yaml"}, "nowhere.yaml"),
    ({"errors": {"stops_mm": 0.1}}, "'stops_mm' is not known. Did you mean stop_sigma_mm"),
    ({"errors": {"targets_err": 1}}, "true or false for 'targets_err'"),
])  # fmt: skip
def test_a_malformed_scenario_is_refused_with_what_is_wrong(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        load_scenario(copied_scenario(tmp_path, **changes))


def test_an_unknown_scenario_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match=r"bench, ideal, industrial.*'shed'"):
        load_scenario("shed")


def test_a_stop_beyond_an_axis_limits_is_refused(tmp_path):
    path = copied_scenario(tmp_path, placement={
        "translation_mm": [5000.0, 0.0, 0.0], "translation_range_mm": [0.0, 0.0, 0.0],
    })  # fmt: skip
    with pytest.raises(InputError, match=r"X within -600.* target 42"):
        draw(load_scenario(path), 1)
