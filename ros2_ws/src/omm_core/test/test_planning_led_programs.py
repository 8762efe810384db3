"""Templates of other controls take corrections: shifted, clamped, tried again, or as planned."""

import pytest
from led_programs import run_program
from planning_cells import kinematics

from omm_core.errors import InputError
from omm_core.planning.other_programs import program_text
from omm_core.planning.program import ProgramOptions, ProgramStop, make_program

LED = ("siemens", "fanuc", "heidenhain")
NONE = ((0.0, 0.0, 0.0), 0, False)
STOPS = [
    ProgramStop(
        axes={"X": 10.0 * i, "Y": 0.0, "Z": 100.0}, label=f"target {i}",
        leave=({"Z": 110.0},) if i > 1 else (),
    )
    for i in range(1, 5)
]  # fmt: skip


def gone_to(control, answers, stops=STOPS, limit_mm=30.0):
    options = ProgramOptions(
        retract_mm=5.0, dwell_s=0.05, feed_mm_per_min=20000.0, limit_mm=limit_mm, tries=3
    )
    text = program_text(make_program(kinematics(), stops, options), control)
    return run_program(control, text, answers)


def places(run):
    return [(number, [at[axis] for axis in "XYZ"]) for number, at in run.asked]


@pytest.mark.parametrize("control", LED)
def test_a_correction_shifts_the_next_stop_and_those_after_it_until_the_next(control):
    told = [((1.5, -2.0, 3.0), 1, True), ((0.0, 0.0, 0.0), 0, True)]
    run = gone_to(control, told)
    assert places(run) == [
        (1, [10.0, 0.0, 100.0]),
        (2, [21.5, -2.0, 103.0]),
        (3, [30.0, 0.0, 100.0]),
        (4, [40.0, 0.0, 100.0]),
    ]
    # A stop is left as it was come to: stop 1 as planned, stop 2 by its shift.
    assert [at["Z"] for at in run.path if 105.0 < at["Z"] < 120.0] == [110.0, 113.0, 110.0]


@pytest.mark.parametrize("control", LED)
def test_the_program_itself_clamps_what_it_is_told(control):
    told = [((500.0, -500.0, 29.0), 1, True), ((-31.0, 30.0, -1e6), 1, True)]
    found = [place for _, place in places(gone_to(control, told))]
    assert found[1:3] == [[50.0, -30.0, 129.0], [0.0, 30.0, 70.0]]


@pytest.mark.parametrize("control", LED)
def test_where_nothing_was_seen_the_same_stop_is_tried_again_and_not_for_ever(control):
    told = [((x, 0.0, 0.0), 2, True) for x in (5.0, -5.0, 7.0)] + [((0.0, 0.0, 0.0), 0, True)]
    assert places(gone_to(control, told))[:5] == [
        (1, [10.0, 0.0, 100.0]),
        (1, [15.0, 0.0, 100.0]),
        (1, [5.0, 0.0, 100.0]),
        (2, [27.0, 0.0, 100.0]),
        (3, [30.0, 0.0, 100.0]),
    ]


@pytest.mark.parametrize("control", LED)
def test_a_correction_that_is_not_valid_is_none(control):
    told = [((9.0, 9.0, 9.0), 2, False)] * 4
    assert places(gone_to(control, told)) == [
        (n, [stop.axes[a] for a in "XYZ"]) for n, stop in enumerate(STOPS, start=1)
    ]


@pytest.mark.parametrize("control", LED)
def test_with_a_limit_of_zero_no_correction_is_read(control):
    told = [((9.0, 9.0, 9.0), 1, True)] * 4
    assert places(gone_to(control, told, limit_mm=0.0))[1] == (2, [20.0, 0.0, 100.0])


@pytest.mark.parametrize("control", [*LED, "fagor"])
def test_a_look_for_the_part_is_linuxcncs_only(control):
    look = [ProgramStop(axes=STOPS[0].axes, label="look", look=True), *STOPS]
    with pytest.raises(InputError, match="for LinuxCNC only"):
        gone_to(control, [], stops=look)
