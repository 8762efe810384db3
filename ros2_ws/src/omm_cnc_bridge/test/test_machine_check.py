"""What `./omm machine show` finds, and that it finds it."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from omm_cnc_bridge.machine.check import check
from omm_cnc_bridge.machine.drawing import draw
from omm_core.machine.kinematics import Kinematics

MACHINES = Path(__file__).parents[1] / "machines"
ISO_841 = sorted(MACHINES.glob("*.urdf"))


def bad(machine: Kinematics) -> list[str]:
    return [finding.text for finding in check(machine) if not finding.good]


@pytest.mark.parametrize("path", ISO_841, ids=lambda p: p.stem)
def test_examples_are_as_iso_841_has_it(path):
    """But for LinuxCNC's 5axiskins, which counts B the other way."""
    found = bad(Kinematics.load(path))
    if path.stem == "linuxcnc_bc_head":
        (text,) = found
        assert text.startswith("+B turns the tool -Y, ISO 841: +Y")
    else:
        assert found == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('<axis xyz="1 0 0"/>', '<axis xyz="-1 0 0"/>', "+X moves the tool -X"),
        ('<axis xyz="1 0 0"/>', '<axis xyz="-1 0 0"/>', "not right-handed"),
        ('lower="-1.0" upper="3.0"', 'lower="-1000" upper="3000"', "Are the limits in m?"),
        ('lower="-1.0" upper="3.0"', 'lower="1.0" upper="3.0"', "zero is outside"),
    ],
)
def test_mistakes_are_found(tmp_path, old, new, expected):
    path = tmp_path / "machine.urdf"
    text = (MACHINES / "three_axis_mill.urdf").read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert any(expected in finding for finding in bad(Kinematics.load(path)))


@pytest.mark.parametrize("path", ISO_841, ids=lambda p: p.stem)
def test_drawing_names_every_axis(path):
    machine = Kinematics.load(path)
    texts = {e.text for e in ET.fromstring(draw(machine)).iter() if e.tag.endswith("text")}
    assert {f"+{axis.name}" for axis in machine.axes} <= texts
