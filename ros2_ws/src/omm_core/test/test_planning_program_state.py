"""Templates of other controls: out along the tool first, whatever is active; state put back."""

import copy
import itertools

import pytest
from led_programs import STARTED, Run, run_program
from planning_cells import kinematics

from omm_core.planning.other_programs import program_text
from omm_core.planning.program import ProgramOptions, ProgramStop, make_program

CONTROLS = ("siemens", "heidenhain", "fanuc", "fagor")
CLEAR_MM = 140.0  # the farthest stop, and retract_mm and limit_mm beyond
STOPS = [
    ProgramStop(axes={"X": 10.0 * i, "Y": -5.0 * i, "Z": 100.0}, label=f"target {i}")
    for i in range(1, 4)
]
INCHES = {"siemens": (70, 700), "fanuc": (20,), "fagor": (70,), "heidenhain": (None,)}


def text_of(control, limit_mm=30.0):
    options = ProgramOptions(retract_mm=10.0, feed_mm_per_min=20000.0, limit_mm=limit_mm)
    if limit_mm == 0.0:
        options = ProgramOptions(retract_mm=40.0, feed_mm_per_min=20000.0)
    return program_text(make_program(kinematics(), STOPS, options), control)


def states(control):
    """From inside the part and from far out, with whatever may be active."""
    for z, inch, distance, feed, tool, inch_machine in itertools.product(
        (-200.0, 900.0), (None, *INCHES[control]), (90, 91), (94, 95), (0, 1), (False, True)
    ):
        g = dict(STARTED[control])
        g |= {"distance": distance, "feed": feed} if g else {}
        g |= {"unit": inch} if g and inch else {}
        yield Run(g=g, axes={"X": 700.0, "Y": 400.0, "Z": z}, tool=tool, length_mm=213.7,
                  radius=True, inch_machine=inch_machine)  # fmt: skip


def moved(before, after):
    return {name for name in before if after[name] != before[name]}


@pytest.mark.parametrize("limit_mm", [0.0, 30.0])
@pytest.mark.parametrize("control", CONTROLS)
def test_from_any_state_the_spindle_goes_out_first_and_every_stop_is_reached(control, limit_mm):
    text = text_of(control, limit_mm)
    for start in states(control):
        run = run_program(control, text, start=copy.deepcopy(start))
        assert not run.alarm
        for (_, found), stop in zip(run.asked, STOPS, strict=True):
            assert found == pytest.approx(dict(stop.axes), abs=1e-9)
        assert max(run.feeds, default=0.0) <= 20000.0 + 1e-6
        way_in = [start.axes, *run.path[: run.path.index(run.asked[0][1]) + 1]]
        out = max(CLEAR_MM, start.axes["Z"])  # farther out it stays
        assert way_in[1]["Z"] == pytest.approx(out)
        for before, after in itertools.pairwise(way_in):
            assert moved(before, after) <= {"Z"} or (
                "Z" not in moved(before, after) and before["Z"] == pytest.approx(out)
            )
        assert moved(*run.path[-2:]) == {"Z"}
        assert run.axes["Z"] == pytest.approx(CLEAR_MM)


@pytest.mark.parametrize("control", ["siemens", "heidenhain", "fanuc"])
def test_units_distances_feed_type_and_tool_are_at_the_end_what_they_were(control):
    text = text_of(control)
    for start in states(control):
        run = run_program(control, text, start=copy.deepcopy(start))
        assert (run.g, run.tool, run.length_mm) == (start.g, start.tool, start.length_mm)


def test_what_cannot_be_put_back_is_said_in_the_program():
    start = Run(g=dict(STARTED["fanuc"]), axes={"X": 0.0, "Y": 0.0, "Z": 0.0}, tool=1)
    assert run_program("fanuc", text_of("fanuc"), start=start).suspended
    assert "(G43 is left alone, but G53 suspends its offset: G43 H again" in text_of("fanuc")
    assert "G71, G90, G94, G1 and F are not put back" in text_of("fagor")
    assert "not: F, G1, R parameters" in text_of("siemens")


@pytest.mark.parametrize(
    ("control", "active", "says"),
    [
        ("siemens", "transformed", "TRAFOOF first"),
        ("fanuc", "transformed", "G49 FIRST"),
        ("fanuc", "tilted", "G69 FIRST"),
        ("heidenhain", "transformed", "PLANE RESET STAY, M129 first"),
        ("heidenhain", "tilted", "PLANE RESET STAY, M129 first"),
    ],
)
def test_under_a_transformation_nothing_is_moved_or_changed_and_why_is_said(control, active, says):
    start = Run(g=dict(STARTED[control]), axes={"X": 1.0, "Y": 2.0, "Z": 3.0}, tool=1)
    setattr(start, active, True)
    text = text_of(control)
    run = run_program(control, text, start=copy.deepcopy(start))
    assert run.alarm
    assert says in run.alarm
    assert (run.path, run.asked, run.g, run.tool) == ([], [], start.g, 1)


def test_no_program_of_fanuc_has_a_g49_which_alone_in_a_block_moves_the_axis():
    """By the length offset: into the part."""
    assert "G49 " not in text_of("fanuc").replace("(G49 FIRST", "")
    start = Run(g=dict(STARTED["fanuc"]), axes={"Z": 300.0}, tool=1, length_mm=213.7)
    run = run_program("fanuc", "G90 G49\nM30", start=start)
    assert run.path == [{"Z": pytest.approx(86.3)}]
