"""A URDF that a person or another program wrote: told what is wrong, or expanded."""

import shutil
import stat

import pytest

from omm_core.errors import InputError
from omm_core.machine.kinematics import Kinematics

TEXT = """<robot name="m" {more}><link name="machine"/><link name="spindle"/>
<joint name="X" type="prismatic"><parent link="machine"/><child link="spindle"/>
<axis xyz="1 0 0"/><limit lower="{lower}" upper="0.5"/></joint></robot>"""


def written(tmp_path, lower="-0.5", more=""):
    path = tmp_path / "mill.urdf"
    path.write_text(TEXT.format(lower=lower, more=more))
    return path


@pytest.mark.parametrize("text", ["-0,5", "left", "", "nan"])
def test_a_limit_that_is_no_number_is_told_with_file_joint_and_attribute(tmp_path, text):
    with pytest.raises(InputError, match=r"mill\.urdf: .*lower in the limit of joint X") as error:
        Kinematics.load(written(tmp_path, text))
    assert repr(text) in str(error.value)


def test_a_robot_of_a_namespace_is_a_robot(tmp_path):
    """As some editors write it; its links and joints are of the same namespace."""
    plain, named = (Kinematics.load(written(tmp_path, more=m)) for m in ("", 'xmlns="urn:x"'))
    assert [a.name for a in named.axes] == [a.name for a in plain.axes] == ["X"]


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def test_a_file_for_xacro_is_called_so_where_xacro_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InputError, match=r"xacro is not installed"):
        Kinematics.load(written(tmp_path, "${-travel/2}", XACRO))


@pytest.mark.parametrize("works", [True, False])
def test_xacro_is_run_where_it_is_installed(tmp_path, monkeypatch, works):
    """With a stand-in that does what xacro does to this file, or refuses it as xacro does."""
    tool = tmp_path / "xacro"
    run = "sed 's/${-travel\\/2}/-0.25/' \"$1\"" if works else "echo 'name travel' >&2; exit 2"
    tool.write_text(f"#!/bin/sh\n{run}\n")
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(shutil, "which", lambda name: str(tool))
    path = written(tmp_path, "${-travel/2}", XACRO)
    if works:
        (axis,) = Kinematics.load(path).axes
        assert axis.lower == -250.0
    else:
        with pytest.raises(InputError, match=r"mill\.urdf: .*name travel"):
            Kinematics.load(path)


@pytest.mark.parametrize("size", [2, 3, 2000])
def test_links_that_go_round_beside_the_root_are_refused_not_followed_for_ever(tmp_path, size):
    names = ["spindle", *(f"l{k}" for k in range(size - 1))]
    joints = "".join(
        f'<joint name="J{k}" type="prismatic"><parent link="{names[k - 1]}"/><child link="{name}"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="1"/></joint>'
        for k, name in enumerate(names)
    )
    links = "".join(f'<link name="{name}"/>' for name in ("base", *names))
    (tmp_path / "mill.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    with pytest.raises(InputError, match=r"mill\.urdf: .*loop"):
        Kinematics.load(tmp_path / "mill.urdf")


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ("X: {ignored: true}", "ignored axes to move neither.*got X"),
        ("W: {follows: V}\n  V: {follows: W}", "axes that follow each other: W, V"),
        ("X2: {follows: X, tolerance_rad: 5}", "tolerance_mm of X2, as X does not turn"),
        ("X2: {follows: X, tolerance_mm: 1, tolerance_rad: 1}", "one of tolerance_mm and"),
    ],
)
def test_rules_of_axes_that_contradict_the_machine_are_refused(tmp_path, axes, words):
    """An ignored axis of the URDF would move the spindle unseen; a circle stands nowhere."""
    written(tmp_path)
    (tmp_path / "machine.yaml").write_text(f"machine: {{urdf: mill.urdf}}\naxes:\n  {axes}\n")
    with pytest.raises(InputError, match=words):
        Kinematics.load(tmp_path / "machine.yaml")


def test_the_length_of_an_axis_says_nothing_however_large(tmp_path):
    path = written(tmp_path)
    path.write_text(path.read_text().replace('xyz="1 0 0"', 'xyz="1e308 0 1e308"'))
    half = Kinematics.load(path).machine_T_spindle({"X": 1.0}).translation_mm
    assert half == pytest.approx([0.5**0.5, 0.0, 0.5**0.5])
