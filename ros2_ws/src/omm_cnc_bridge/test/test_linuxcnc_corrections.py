"""LinuxCNC itself takes corrections: shifted, clamped by the program, tried again, or none."""

import threading
import time
from pathlib import Path

import pytest

from omm_cnc_bridge.control import ProgramState
from omm_cnc_bridge.controls.linuxcnc.cell import LinuxCncCell, can_isolate, is_installed
from omm_cnc_bridge.controls.linuxcnc.control import LinuxCncControl
from omm_core.machine.kinematics import Kinematics
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.program import ProgramOptions, ProgramStop, make_program

pytestmark = [
    pytest.mark.skipif(not is_installed(), reason="LinuxCNC is not installed"),
    pytest.mark.skipif(not can_isolate(), reason="the system does not allow namespaces (unshare)"),
]
MACHINE = Path(__file__).parents[1] / "machines" / "three_axis_mill.urdf"
STOPS = [
    ProgramStop(axes={"X": 10.0 * i, "Y": 0.0, "Z": 100.0}, label=f"target {i}")
    for i in range(1, 5)
]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with LinuxCncCell("three_axis_mill", tmp_path_factory.mktemp("linuxcnc")) as running:
        options = ProgramOptions(
            retract_mm=5.0, dwell_s=0.05, feed_mm_per_min=20000.0, limit_mm=30.0, tries=3,
            answer_timeout_s=60.0,
        )  # fmt: skip
        text = linuxcnc_program(make_program(Kinematics.load(MACHINE), STOPS, options))
        (running.folder / "measure.ngc").write_text(text)
        yield running


def gone_to(cell, answers) -> list[tuple[int, list[float]]]:
    """Run the program; ``answers``: what each image is answered with. Requests, and where."""
    program = str(cell.folder / "measure.ngc")
    control = LinuxCncControl(rate_hz=100, reader=cell.reader, program_file=program)
    control.connect()
    places: list[tuple[int, list[float]]] = []
    answers = list(answers)
    try:
        control.correct((0.0, 0.0, 0.0), 0, valid=False)
        starting = threading.Thread(target=control.start_program)
        starting.start()
        asked, deadline, state = False, time.monotonic() + 120.0, ProgramState.UNKNOWN
        while state is not ProgramState.FINISHED and time.monotonic() < deadline:
            for sample in control.read(0.05):
                state = sample.program_state if places else state
                if sample.measure_request is None:
                    asked = False
                elif not asked:
                    asked = True
                    at = [round(sample.commanded[a], 3) for a in "XYZ"]
                    places.append((sample.measure_request, at))
                    if answers:
                        shift, status = answers.pop(0)
                        control.correct(shift, status or 0, valid=status is not None)
                    control.acknowledge(sample.measure_request)
        starting.join()
    finally:
        control.close()
    assert state is ProgramState.FINISHED
    return places


def test_a_correction_shifts_the_next_stop_and_those_after_it_until_the_next(cell):
    told = [((1.5, -2.0, 3.0), 1), ((0.0, 0.0, 0.0), 0)]
    assert gone_to(cell, told) == [
        (1, [10.0, 0.0, 100.0]),
        (2, [21.5, -2.0, 103.0]),
        (3, [30.0, 0.0, 100.0]),
        (4, [40.0, 0.0, 100.0]),
    ]


def test_the_program_itself_clamps_what_it_is_told(cell):
    told = [((500.0, -500.0, 29.0), 1), ((-31.0, 30.0, -1e6), 1), ((0.0, 0.0, 0.0), 0)]
    assert [place for _, place in gone_to(cell, told)][1:3] == [
        [50.0, -30.0, 129.0],
        [0.0, 30.0, 70.0],
    ]


def test_where_nothing_was_seen_the_same_stop_is_tried_again_and_not_for_ever(cell):
    told = [((5.0, 0.0, 0.0), 2), ((-5.0, 0.0, 0.0), 2), ((7.0, 0.0, 0.0), 2), ((0, 0, 0), 0)]
    assert gone_to(cell, told)[:4] == [
        (1, [10.0, 0.0, 100.0]),
        (1, [15.0, 0.0, 100.0]),
        (1, [5.0, 0.0, 100.0]),
        (2, [27.0, 0.0, 100.0]),
    ]


def test_a_correction_that_is_not_valid_is_none(cell):
    told = [((9.0, 9.0, 9.0), None)] * 4
    assert [place for _, place in gone_to(cell, told)] == [list(s.axes.values()) for s in STOPS]
