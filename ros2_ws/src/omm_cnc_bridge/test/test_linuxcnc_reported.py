"""What a LinuxCNC says of its joints, through a reader that is told what to say."""

import json
import sys

import pytest

from omm_cnc_bridge.controls.linuxcnc.control import LinuxCncControl
from omm_core.errors import DeviceError

HELLO = {
    "joints": 4, "letters": "XYZA", "rotary": [False, False, False, True],
    "linear_units_per_mm": 1 / 25.4, "angular_units_per_degree": 1.0, "sampled": True,
    "servo_s": 0.001, "task_s": 0.01,
}  # fmt: skip
STATUS = {"mode": 2, "interpreter": 1, "finished": False, "waiting": False, "program": "",
          "line": 1, "homed": [True] * 4, "orientation": 0, "spindle_deg": None}  # fmt: skip


def control(positions, hello=HELLO, row=None) -> LinuxCncControl:
    """A control whose reader reports positions, in inches and degrees, every 10 ms."""
    row = row or [1, positions, positions, 1.0, 0.0, 0.0, 0.0]
    lines = [json.dumps(m) for m in ({"hello": hello}, {"status": STATUS}, {"samples": [row]})]
    program = f"import time\nprint({lines[0]!r}, flush=True)\nprint({lines[1]!r}, flush=True)\n"
    program += f"while True:\n    print({lines[2]!r}, flush=True)\n    time.sleep(0.01)\n"
    return LinuxCncControl(rate_hz=100, reader=[sys.executable, "-I", "-c", program])


def sample(made: LinuxCncControl):
    try:
        made.connect()
        for _ in range(100):
            if samples := made.read(0.1):
                return samples[-1]
    finally:
        made.close()
    raise AssertionError("no sample")


def test_an_inch_machine_is_told_in_mm_and_rad_and_which_axes_turn():
    one = sample(control([1.0, 2.0, -3.0, 180.0]))
    assert one.positions == pytest.approx({"X": 25.4, "Y": 50.8, "Z": -76.2, "A": 3.14159265})
    assert one.turning == {"X": False, "Y": False, "Z": False, "A": True}


@pytest.mark.parametrize("value", [None, "1,5", float("nan")])
def test_a_joint_without_a_number_is_unusable_by_name(value):
    one = sample(control([1.0, value, 3.0, 4.0]))
    assert set(one.positions) == {"X", "Z", "A"}
    assert "is not a number" in one.unusable["Y"]


@pytest.mark.parametrize(
    "row",
    [
        [1, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], 1.0, 0.0, 0.0, 0.0],
        [1, [1.0, 2.0, 3.0, 4.0], None, 1.0, 0.0, 0.0, 0.0],
        [None, [1.0] * 4, [1.0] * 4, 1.0, 0.0, 0.0, 0.0],
        [1, [1.0] * 4],
    ],
)
def test_a_row_that_lacks_joints_is_refused_not_cut(row):
    with pytest.raises(DeviceError, match="positions of 4 joints"):
        sample(control([], row=row))


def test_a_reader_of_another_version_is_told_of():
    with pytest.raises(DeviceError, match=r"rotary from LinuxCNC's reader.*linuxcnc_reader\.py"):
        sample(control([], {k: v for k, v in HELLO.items() if k != "rotary"}))
