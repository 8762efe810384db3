"""Laws of the simulated control and its machine."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from omm_simulation.cell import draw
from omm_simulation.control import SimulatedControl
from omm_simulation.control_state import ProgramState
from omm_simulation.machine_errors import MachineErrors
from omm_simulation.scenario import load_scenario

MS = 1_000_000
AXES = "XYZ"


def exact(name):
    """A scenario on a machine without errors."""
    return dataclasses.replace(load_scenario(name), errors=MachineErrors())


def run_through(control, *, answer_after_ms=50, step_ms=10, until_ms=200_000):
    """States (and true positions) of a whole program; every image is acknowledged in time."""
    states, true_mm, asked_ns = [], [], None
    for time_ns in range(0, until_ms * MS, step_ms * MS):
        state = control.state(time_ns)
        states.append(state)
        true_mm.append(control.true_machine_T_spindle(time_ns).translation_mm)
        if state.measure_requested and asked_ns is None:
            asked_ns = time_ns
        if asked_ns is not None and time_ns >= asked_ns + answer_after_ms * MS:
            assert control.acknowledge(state.measure_request, time_ns)
            asked_ns = None
        if state.program_state is ProgramState.FINISHED:
            return states, np.array(true_mm)
    pytest.fail(f"The program did not end within {until_ms} ms.")


@pytest.fixture(scope="module", params=["bench", "industrial"])
def cell(request):
    return draw(exact(request.param), 7)


@pytest.fixture(scope="module")
def measured(cell):
    return run_through(SimulatedControl(cell))


def test_the_program_asks_for_an_image_at_every_stop_in_order(cell, measured):
    states, _ = measured
    asked = [s for before, s in pairwise(states)
             if s.measure_requested and not before.measure_requested]  # fmt: skip
    assert [s.measure_request for s in asked] == list(range(1, len(cell.stops) + 1))
    for state, stop in zip(asked, cell.stops):
        np.testing.assert_allclose(
            state.axis_commanded_mm, stop.spindle_in_machine_mm, rtol=0, atol=1e-9
        )
        assert state.program_state is ProgramState.WAITING
    assert states[-1].measure_acknowledged == len(cell.stops)


def test_the_axes_have_settled_and_the_spindle_is_still_when_an_image_is_asked_for(measured):
    states, true_mm = measured
    for state, true in zip(states, true_mm):
        if state.measure_requested:
            assert np.abs(state.axis_positions_mm - state.axis_commanded_mm).max() < 1e-4
            assert np.abs(true - state.axis_positions_mm).max() < 1e-4


def test_in_position_precedes_settling(measured):
    """As measured on LinuxCNC: the flag follows the command, not the machine."""
    states, _ = measured
    arrivals = [s for before, s in pairwise(states)
                if s.in_position and not before.in_position]  # fmt: skip
    off_mm = [np.abs(s.axis_positions_mm - s.axis_commanded_mm).max() for s in arrivals]
    assert len(arrivals) >= 8
    assert min(off_mm) > 0.02


def test_the_spindle_still_swings_when_the_axes_move_no_more(measured):
    states, true_mm = measured
    hidden_mm = [np.abs(true - s.axis_positions_mm).max() for s, true in zip(states, true_mm)]
    settled = [np.abs(s.axis_positions_mm - s.axis_commanded_mm).max() < 5e-4 for s in states]
    assert np.array(hidden_mm)[settled].max() > 2e-4


def test_axes_keep_their_limits(cell):
    control = SimulatedControl(cell)
    states, _ = run_through(control, step_ms=5)
    commanded = np.array([s.axis_commanded_mm for s in states])
    velocity = np.diff(commanded, axis=0) / 5e-3
    acceleration = np.diff(velocity, axis=0) / 5e-3
    for k, name in enumerate(AXES):
        axis = cell.scenario.machine.axes[name]
        assert np.abs(velocity[:, k]).max() <= axis.velocity_mm_per_s * (1 + 1e-9)
        assert np.abs(acceleration[:, k]).max() <= axis.acceleration_mm_per_s2 * (1 + 1e-6)
        assert commanded[:, k].min() >= axis.minimum_mm
        assert commanded[:, k].max() <= axis.maximum_mm
    fastest = max(np.abs(velocity[:, k]).max() / cell.scenario.machine.axes[n].velocity_mm_per_s
                  for k, n in enumerate(AXES))  # fmt: skip
    assert fastest > 0.99


def test_the_bench_program_is_short_enough_for_a_demo():
    states, _ = run_through(SimulatedControl(draw(load_scenario("bench"), 7)))
    assert states[-1].stamp_ns < 12_000 * MS


def test_the_speed_factor_shortens_moves_and_leaves_dwells():
    cell = draw(load_scenario("bench"), 7)
    normal, _ = run_through(SimulatedControl(cell))
    fast, _ = run_through(SimulatedControl(cell, speed_factor=2.0))
    program = cell.scenario.program
    resting_s = len(cell.stops) * (program.dwell_s + program.rest_after_s + 0.05)
    moving_s = normal[-1].stamp_ns * 1e-9 - resting_s
    assert fast[-1].stamp_ns * 1e-9 - resting_s == pytest.approx(moving_s / 2, abs=0.15)


def test_equal_times_and_events_give_equal_answers(cell):
    first, first_true = run_through(SimulatedControl(cell), step_ms=20)
    again, again_true = run_through(SimulatedControl(cell), step_ms=20)
    np.testing.assert_array_equal(first_true, again_true)
    for a, b in zip(first, again):
        np.testing.assert_array_equal(a.axis_positions_mm, b.axis_positions_mm)
        assert (a.program_state, a.program_line) == (b.program_state, b.program_line)


def test_a_time_can_be_asked_for_again_later():
    control = SimulatedControl(draw(load_scenario("bench"), 7))
    states, true_mm = run_through(control)
    for k in range(0, len(states), 7):
        if states[k].measure_requested:
            continue  # at the very time of an answer, the state is another after it than before
        again = control.state(states[k].stamp_ns)
        np.testing.assert_array_equal(again.axis_positions_mm, states[k].axis_positions_mm)
        assert again.in_position == states[k].in_position
        np.testing.assert_array_equal(
            control.true_machine_T_spindle(states[k].stamp_ns).translation_mm, true_mm[k]
        )


def test_without_an_acknowledgement_the_program_goes_on_after_its_time_out():
    control = SimulatedControl(draw(load_scenario("bench"), 7))
    time_ns = 0
    while not control.state(time_ns).measure_requested:
        time_ns += 10 * MS
    asked_ns = time_ns
    while control.state(time_ns).measure_requested:
        time_ns += 10 * MS
    assert (time_ns - asked_ns) * 1e-9 == pytest.approx(5.0, abs=0.03)
    assert control.state(time_ns).measure_acknowledged == 0
    assert not control.acknowledge(1, time_ns)  # too late: it no longer waits for that one
    assert not control.state(time_ns + 500 * MS).in_position  # and it is on its way


def test_an_acknowledgement_of_another_image_changes_nothing():
    control = SimulatedControl(draw(load_scenario("bench"), 7))
    time_ns = 0
    while not control.state(time_ns).measure_requested:
        time_ns += 10 * MS
    assert not control.acknowledge(2, time_ns)
    assert control.state(time_ns + 100 * MS).measure_requested


def test_the_program_starts_when_it_is_told():
    cell = draw(load_scenario("bench"), 7)
    control = SimulatedControl(cell, start_ns=1000 * MS)
    before = control.state(999 * MS)
    assert before.program_state is ProgramState.STOPPED
    np.testing.assert_allclose(before.axis_positions_mm, cell.scenario.machine.home_mm, atol=1e-9)
    assert control.state(1001 * MS).program_state is ProgramState.RUNNING


def test_the_stops_are_gone_through_as_often_as_told():
    cell = draw(load_scenario("bench"), 7)
    states, _ = run_through(SimulatedControl(cell, repetitions=2), step_ms=20)
    assert states[-1].measure_acknowledged == 2 * len(cell.stops)


def with_machine(cell, **changes):
    machine = dataclasses.replace(cell.scenario.machine, **changes)
    return dataclasses.replace(cell, scenario=dataclasses.replace(cell.scenario, machine=machine))


def erring(cell, **sizes):
    scenario = dataclasses.replace(cell.scenario, errors=MachineErrors(**sizes))
    return draw(scenario, cell.seed)


def at_images(cell):
    """Return true minus reported and the programmed positions while images are asked for."""
    states, true_mm = run_through(SimulatedControl(cell), step_ms=20)
    off = {s.measure_request: true - s.axis_positions_mm
           for s, true in zip(states, true_mm) if s.measure_requested}  # fmt: skip
    return np.array(list(off.values()))


def test_positions_are_reported_in_steps_of_the_resolution():
    cell = with_machine(draw(load_scenario("bench"), 7), position_resolution_mm=0.25)
    states, _ = run_through(SimulatedControl(cell), step_ms=20)
    steps = np.array([s.axis_positions_mm for s in states]) / 0.25
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_positions_are_true_up_to_the_machines_own_error():
    quiet = draw(load_scenario("bench"), 7)
    errors_mm = []
    for seed in range(8):
        cell = dataclasses.replace(erring(quiet, stop_sigma_mm=0.01), clamping_seed=seed)
        errors_mm += list(at_images(cell))
    # 8 × 8 × 3 draws: 4 σ of the spread of a standard deviation.
    assert np.std(errors_mm) == pytest.approx(0.01, rel=4 / (2 * 192) ** 0.5)


def test_at_a_stop_the_spindle_is_off_by_the_geometry_there():
    cell = erring(draw(load_scenario("bench"), 7), geometry_sigma_mm=0.02)
    off = at_images(cell)
    np.testing.assert_allclose(off, cell.geometry_at_stops_mm(), rtol=0, atol=2e-4)
    assert np.std(off) > 0.002


def test_each_axis_stays_behind_by_half_its_lost_motion():
    width = np.array([0.01, 0.02, 0.04])
    off = at_images(erring(draw(load_scenario("bench"), 7), lost_motion_mm=tuple(width)))
    np.testing.assert_allclose(np.abs(off), np.tile(width / 2, (8, 1)), rtol=0, atol=2e-4)
    assert len(np.unique(np.sign(off[:, :2]))) == 2  # they come from either side


def test_the_spindle_drifts_as_it_gets_warm_and_stands_still_at_a_stop():
    cell = erring(draw(load_scenario("bench"), 7), spindle_drift_mm=(0.0, 0.0, 0.05),
                  spindle_drift_s=20.0)  # fmt: skip
    off = at_images(cell)[:, 2]
    assert np.all(np.diff(off) > 0.0)
    assert off[-1] < 0.0502
    states, true_mm = run_through(SimulatedControl(cell), step_ms=20)
    asked = np.array([s.measure_request if s.measure_requested else 0 for s in states])
    for request in range(1, 9):
        assert np.ptp(true_mm[asked == request], axis=0).max() < 1e-4


def test_the_tool_of_a_horizontal_spindle_points_along_y():
    cell = draw(load_scenario("industrial"), 7)
    pose = SimulatedControl(cell).true_machine_T_spindle(0)
    np.testing.assert_allclose(pose.rotation @ [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], atol=1e-12)
