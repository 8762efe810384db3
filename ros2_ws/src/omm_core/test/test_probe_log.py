"""Probe logs of several controls say where the probe was; what cannot be meant is refused."""

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.probe_log import read_probe_log, with_log
from omm_core.files.probed import ProbedPoint

PLACES = [[612.3405, -14.25, 88.1], [1.5, 2.0, -0.125]]
LOGS = {
    "linuxcnc": "612.3405 -14.2500 88.1000 0 0 0 0 0 0\n1.5 2.0 -0.125 0 0 0 0 0 0\n",
    # DPRNT[P1*X#5061[44]Y#5062[44]Z#5063[44]], with blanks for leading zeros
    "fanuc": "%\nP1 X 612.3405Y -14.2500Z  88.1000\nP2 X   1.5000Y   2.0000Z  -0.1250\n%\n",
    # WRITE(ERR, "LOG", "P1 X=" << $AA_MM[X] << " Y=" << $AA_MM[Y] << " Z=" << $AA_MM[Z])
    "siemens": ";probing\nP1 X=612.3405 Y=-14.25 Z=88.1\nP2 X=1.5 Y=2 Z=-.125\n",
    # FN 16: "P%02.0f: X %+10.4f  Y ..."
    "heidenhain": "LOG 2026\r\nP1: X +612.3405  Y -14.2500  Z +88.1000\r\n"
    "P2: X +1.5000  Y +2.0000  Z -0.1250\r\n",
    "no names": "x612.3405 y-14.25 z88.1\nx1.5 y2 z-1.25e-1\n",
}


def points(*names):
    return tuple(ProbedPoint(name=n, part_mm=np.zeros(3), machine_mm=None) for n in names)


def log(tmp_path, text):
    path = tmp_path / "probe.log"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("name", LOGS)
def test_each_controls_log_gives_the_same_places(name, tmp_path):
    found = with_log(points("P1", "P2"), log(tmp_path, LOGS[name]), (10.0, 0.0, -1.0))
    expected = np.array(PLACES) + (10.0, 0.0, -1.0)
    assert np.array([point.machine_mm for point in found]) == pytest.approx(expected)


def test_a_log_with_names_counts_by_name_and_repeats_in_their_order(tmp_path):
    text = "B X1 Y0 Z0\nA X2 Y0 Z0\nB X3 Y0 Z0\n"
    found = with_log(points("A", "B", "B"), log(tmp_path, text))
    assert [point.machine_mm[0] for point in found] == [2.0, 1.0, 3.0]


def test_names_that_are_none_of_the_points_are_headings_and_the_order_counts(tmp_path):
    found = with_log(points("A", "B"), log(tmp_path, "N10 X1 Y0 Z0\nN20 X2 Y0 Z0\n"))
    assert [point.machine_mm[0] for point in found] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "found none"),
        ("nothing probed\n", "found none"),
        ("A X1 Y2\nB X1 Y2 Z3\n", "once each"),
        ("A X1 Y2 Z3 X4\n", "once each"),
        ("A X1,5 Y2 Z3\n", "decimal points"),
        ("G20\nA X1 Y2 Z3\n", "inches"),
        ("A X1 Y2 Z3\n", "of 'B'"),
        ("A X1 Y2 Z3\nB X1 Y2 Z3\nA X1 Y2 Z3\n", "more often"),
        ("A X1 Y2 Z3\nC X1 Y2 Z3\n", "names, got 'C'"),
        ("X1 Y2 Z3\n", "each of the 2"),
        ("A X1e999 Y2 Z3\nB X1 Y2 Z3\n", "finite"),
        ("1 2 3\n", "9 numbers"),
    ],
)
def test_a_log_that_cannot_be_meant_is_refused(text, told, tmp_path):
    with pytest.raises(InputError, match=told):
        with_log(points("A", "B"), log(tmp_path, text))


def test_a_line_tells_its_number(tmp_path):
    assert [touch.line for touch in read_probe_log(log(tmp_path, LOGS["fanuc"]))] == [2, 3]
