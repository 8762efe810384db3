"""What an agent's model says of filters, constraints and tool points is heard before its values."""

import math
from pathlib import Path

import mtconnect_agent
import pytest
from mtconnect_agent import Agent

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.controls.mtconnect.control import MtConnectControl
from omm_cnc_bridge.controls.mtconnect.model import read_device
from omm_cnc_bridge.judgement import Judge, Reported, SampleLimits
from omm_cnc_bridge.standstill import StandStillLimits
from omm_core.errors import InputError
from omm_core.machine.kinematics import Kinematics

MACHINES = Path(__file__).parents[1] / "machines"
POINT = '<DataItem id="tp" category="SAMPLE" type="PATH_POSITION" units="MILLIMETER_3D"'
X_ITEM = 'subType="ACTUAL" coordinateSystem="MACHINE" units="MILLIMETER"/>'


def sample_of(monkeypatch, probe: str, *, tool_point: bool = False, **values) -> ControlSample:
    """First sample of an agent whose model is ``probe``."""
    monkeypatch.setattr(mtconnect_agent, "PROBE", probe)
    monkeypatch.setitem(mtconnect_agent.TAGS, "tp", "PathPosition")
    with Agent() as agent:
        agent.tell(**{**mtconnect_agent.GOOD, **values})
        control = MtConnectControl(agent.url, rate_hz=100, tool_point=tool_point)
        control.connect()
        sample = control.read(3.0)[-1]
        control.close()
    return sample


def with_inside(inside: str) -> str:
    """The agent's model, with elements inside the measured position of X."""
    return mtconnect_agent.PROBE.replace(X_ITEM, X_ITEM[:-2] + f">{inside}</DataItem>", 1)


def judged(sample: ControlSample, machine: str = "three_axis_mill", **more) -> str:
    judge = Judge(
        Kinematics.load(MACHINES / f"{machine}.urdf"),
        StandStillLimits(),
        SampleLimits(stamp_uncertainty_ns=10**9),
        **more,
    )
    return str(judge.judge(sample, sample.stamp_ns).refused)


@pytest.mark.parametrize(
    ("inside", "why"),
    [
        ('<Filters><Filter type="MINIMUM_DELTA">0.1</Filter></Filters>', "moved by 0.1 mm unseen"),
        ('<Constraints><Filter type="MINIMUM_DELTA">0.1</Filter></Constraints>', "MINIMUM_DELTA"),
        ('<Filters><Filter type="PERIOD">10</Filter></Filters>', "moved for 10 s unseen"),
        ('<Filters><Filter type="MINIMUM_DELTA">0.001</Filter></Filters>', ""),
        ('<Filters><Filter type="PERIOD">0.01</Filter></Filters>', ""),
        ('<Filters><Filter type="MINIMUM_DELTA">0,1</Filter></Filters>', "is no number"),
        ('<Filters><Filter type="MINIMUM_DELTA">-1</Filter></Filters>', "not understood"),
        ('<Filters><Filter type="AVERAGE">1</Filter></Filters>', "not understood (AVERAGE"),
        ("<Constraints><Value>0</Value></Constraints>", "a constant"),
        ("<Constraints><Minimum>0</Minimum><Maximum>50</Maximum></Constraints>", "(0 to 50"),
        ("<Constraints><Minimum>0</Minimum><Maximum>500</Maximum></Constraints>", ""),
        ("<Constraints><Nominal>3</Nominal></Constraints>", ""),
    ],
)
def test_what_an_agent_keeps_to_itself_is_seen_in_its_model(monkeypatch, inside, why):
    sample = sample_of(monkeypatch, with_inside(inside))
    positions = {"Z": 0.0, **{a: v for a, v in sample.positions.items() if a != "B"}}
    known = ControlSample(
        stamp_ns=sample.stamp_ns,
        stamp_uncertainty_ns=0,
        positions=positions,
        unusable=sample.unusable,
        unseen=sample.unseen,
    )
    judge = Judge(
        Kinematics.load(MACHINES / "three_axis_mill.urdf"), StandStillLimits(), SampleLimits()
    )
    refused = str(judge.judge(known, known.stamp_ns).refused)
    assert (why in refused) if why else refused == ""
    assert not why or "axis X" in refused


def test_a_minimum_delta_is_in_the_units_of_its_item():
    text = with_inside('<Filters><Filter type="MINIMUM_DELTA">0.5</Filter></Filters>')
    text = text.replace("MILLIMETER", "INCH", 3).format(version="2", instance=1, size=9)
    items = read_device(text.encode(), "").items
    assert items["xa"].limits.unseen.distance == pytest.approx(12.7)


@pytest.mark.parametrize(("component", "unit"), [("Rotary", "DEGREE"), ("Linear", "MILLIMETER")])
def test_an_axis_that_turns_is_no_length_whatever_its_name(monkeypatch, component, unit):
    name = "X" if component == "Rotary" else "B"
    kind = "ANGLE" if component == "Rotary" else "POSITION"
    item = f'<DataItem id="ba" category="SAMPLE" type="{kind}" units="{unit}"/>'
    probe = (
        '<MTConnectDevices><Devices><Device name="m"><Components><Axes><Components>'
        f'<{component} id="b" name="{name}"><DataItems>{item}</DataItems></{component}>'
        "</Components></Axes></Components></Device></Devices></MTConnectDevices>"
    )
    sample = sample_of(monkeypatch, probe, ba=90)
    assert "the machine's URDF has it as" in judged(sample, "linuxcnc_bc_head")


def test_a_tool_point_beside_a_turning_axis_is_used_by_wish_only(monkeypatch):
    path = 'id="p"><DataItems>'
    probe = mtconnect_agent.PROBE.replace("Linear", "Other")
    probe = probe.replace(path, f'{path}{POINT} coordinateSystem="MACHINE"/>')
    values = {"tp": "1.5 2 -3", "ba": 90}
    plain = sample_of(monkeypatch, probe, **values)
    assert plain.positions == {"B": pytest.approx(math.pi / 2)}
    assert "reported:=tool_point" in plain.unusable["X"]
    wished = sample_of(monkeypatch, probe, tool_point=True, **values)
    assert wished.positions == {"X": 1.5, "Y": 2.0, "Z": -3.0, "B": pytest.approx(math.pi / 2)}
    assert not wished.unusable


def test_where_the_tool_point_is_wished_for_it_stands_in_the_place_of_the_axes(monkeypatch):
    path = 'id="p"><DataItems>'
    probe = mtconnect_agent.PROBE.replace(path, f'{path}{POINT} coordinateSystem="MACHINE"/>')
    assert sample_of(monkeypatch, probe, tp="7 8 9").positions["X"] == 71.45
    wished = sample_of(monkeypatch, probe, tool_point=True, tp="7 8 9")
    assert [wished.positions[axis] for axis in "XYZ"] == [7.0, 8.0, 9.0]
    assert not wished.commanded
    gone = sample_of(monkeypatch, probe, tool_point=True, tp="UNAVAILABLE")
    assert "UNAVAILABLE" in judged(gone, reported=Reported.TOOL_POINT)


@pytest.mark.parametrize(
    "url", ["localhost:5000", "192.168.1.5:5000", "http://:5000", "http://mill:abc", "", "ftp://a"]
)
def test_an_address_that_names_no_agent_is_refused_and_not_guessed(url):
    with pytest.raises(InputError, match="http://HOST:PORT"):
        MtConnectControl(url, rate_hz=100)


@pytest.mark.parametrize(
    ("digits", "value", "unit", "step_mm"),
    [(4, 71.45, "MILLIMETER", 0.01), (4, 1234.5, "MILLIMETER", 1.0),
     (9, 1234.5, "MILLIMETER", 1e-5), (3, -0.0712, "MILLIMETER", 1e-4),
     (4, 71.45, "INCH", 0.254), (4, 0, "MILLIMETER", 0.0)],
)  # fmt: skip
def test_what_rounding_hides_is_a_digit_of_the_value(monkeypatch, digits, value, unit, step_mm):
    item = X_ITEM.replace("MILLIMETER", unit)
    probe = mtconnect_agent.PROBE.replace(
        X_ITEM, item.replace("/>", f' significantDigits="{digits}"/>'), 1
    )
    sample = sample_of(monkeypatch, probe, xa=value)
    assert sum(u.distance for u in sample.unseen.values()) == pytest.approx(step_mm)
    told = judged(sample)
    assert (f"significantDigits {digits}" in told) == (step_mm > StandStillLimits().tolerance_mm)
