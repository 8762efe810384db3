"""Centres without images are those of the images, and Monte Carlo of them finds the errors."""

import dataclasses

import numpy as np
import pytest

from omm_core.geometry import RigidTransform
from omm_core.session.measurement import Measurement
from omm_simulation.cell import draw
from omm_simulation.centres import observed_centres, stops_of
from omm_simulation.control import SimulatedControl
from omm_simulation.erring_spindle import ErringSpindle
from omm_simulation.machine_errors import MachineErrors
from omm_simulation.offline import ImageMessage, run
from omm_simulation.scenario import load_scenario


def erring(**sizes):
    return dataclasses.replace(load_scenario("ideal"), errors=MachineErrors(**sizes))


@pytest.fixture(scope="module")
def cell():
    return draw(
        erring(stop_sigma_mm=0.02, geometry_sigma_mm=0.05, lost_motion_mm=(0.01, 0.02, 0.03),
               holder_sigma_mm=(0.02, 0.02, 0.02), part_warmth_K=2.0), 4
    )  # fmt: skip


def test_centres_are_where_the_images_show_them(cell):
    measurement = Measurement(cell.scenario.part, cell.scenario.calibration)
    for message in run(cell, noise=False):
        if isinstance(message, ImageMessage):
            measurement.add_image(message.stamp_ns, message.image)
        else:
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
    seen = measurement.result().solution.observations
    made = observed_centres(cell, 1e-9, np.random.default_rng(0))
    assert [o.target_id for o in seen] == [o.target_id for o in made]
    off = np.array([a.center_px - b.center_px for a, b in zip(seen, made)])
    # 0.01 px of the detector; a stop's 0.02 mm are 0.2 px here.
    assert np.abs(off).max() < 0.03


def test_the_control_reports_nothing_of_what_the_spindle_is_off(cell):
    stops = list(stops_of(cell))
    programmed = np.array([s.spindle_in_machine_mm for s in cell.stops])
    reported, true = (
        np.array([getattr(s, name).translation_mm for s in stops]) for name in ("reported", "true")
    )
    np.testing.assert_allclose(reported, programmed, atol=1e-3)
    assert np.std(true - reported) > 0.01


def test_each_clamping_has_stops_of_its_own_and_one_machine():
    scenario = erring(stop_sigma_mm=0.005, geometry_sigma_mm=0.02)
    off = np.array([
        [s.true.translation_mm - s.reported.translation_mm for s in stops_of(
            draw(scenario, 1, clamping_seed=k))]
        for k in range(40)
    ])  # fmt: skip
    geometry = draw(scenario, 1).geometry_at_stops_mm()
    np.testing.assert_allclose(off.mean(axis=0), geometry, atol=4.5 * 0.005 / np.sqrt(40))
    assert np.std(off - geometry) == pytest.approx(0.005, rel=0.1)


def test_a_control_that_moves_by_itself_errs_alike():
    """Geometry and lost motion at each stop as with the simulated control; noise of its own."""
    cell = draw(erring(geometry_sigma_mm=0.02, lost_motion_mm=(0.01, 0.02, 0.03)), 4)
    control, spindle = SimulatedControl(cell), ErringSpindle(cell)
    compared = set()
    for time_ns in range(0, 60_000_000_000, 10_000_000):
        state = control.state(time_ns)
        true = spindle.true_pose(time_ns, state.machine_T_spindle)
        if state.measure_requested:
            expected = control.true_machine_T_spindle(time_ns)
            np.testing.assert_allclose(true.translation_mm, expected.translation_mm, atol=1e-3)
            control.acknowledge(state.measure_request, time_ns)
            compared.add(state.measure_request)
    assert len(compared) == len(cell.stops)


def test_a_spindle_stands_where_it_stopped_and_stops_anew_elsewhere():
    spindle = ErringSpindle(draw(erring(stop_sigma_mm=0.01), 4))
    at = [RigidTransform.from_euler_xyz_rad(0, 0, 0, (x, 0.0, 0.0)) for x in (0.0, 50.0)]
    standing = [spindle.true_pose(k, at[1 if k > 3 else 0]).translation_mm for k in range(9)]
    np.testing.assert_array_equal(standing[0], 0.0)
    assert np.any(standing[4] != at[1].translation_mm)
    np.testing.assert_array_equal(standing[4:], [standing[4]] * 5)
