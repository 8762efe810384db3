"""What a position of an MTConnect model means: shown by the model, or refused by name."""

import mtconnect_agent
import pytest
from mtconnect_agent import Agent

from omm_cnc_bridge.controls.mtconnect.control import MtConnectControl
from omm_cnc_bridge.controls.mtconnect.model import read_device
from omm_core.errors import DeviceError, InputError

SYSTEMS = """<Configuration><CoordinateSystems><CoordinateSystem id="mc" type="MACHINE"/>
<CoordinateSystem id="wc" type="OBJECT" parentIdRef="mc"/></CoordinateSystems></Configuration>"""
GOOD = 'category="SAMPLE" type="POSITION" subType="ACTUAL" units="MILLIMETER"'


def model(*items: str, component: str = "Linear", name: str = "X", more: str = "") -> bytes:
    """A device whose first axis has the items, and a second one, Y, that is plain."""
    data = "".join(f"<DataItem {item}/>" for item in items)
    return (
        f'<MTConnectDevices><Devices><Device name="mill">{SYSTEMS}<Components><Axes><Components>'
        f'<{component} id="c" name="{name}"><DataItems>{data}</DataItems></{component}>'
        f'<Linear id="y" name="Y"><DataItems><DataItem id="y1" {GOOD}/></DataItems></Linear>{more}'
        "</Components></Axes></Components></Device></Devices></MTConnectDevices>"
    ).encode()


def chosen(text: bytes) -> str | None:
    """Id of the measured position of X."""
    items = read_device(text, "").items
    return next(
        (i for i, item in items.items() if (item.role, item.axis) == ("measured", "X")), None
    )


@pytest.mark.parametrize(
    "other",
    [
        f'id="o" {GOOD} coordinateSystemIdRef="wc"',
        f'id="o" {GOOD} coordinateSystem="WORK"',
        f'id="o" {GOOD} coordinateSystem="WORK" coordinateSystemIdRef="mc"',
        f'id="o" {GOOD} coordinateSystemIdRef="nowhere"',
        f'id="o" {GOOD}',
        f'id="o" {GOOD} representation="TIME_SERIES" sampleRate="100"',
        f'id="o" {GOOD} statistic="AVERAGE"',
        'id="o" category="CONDITION" type="POSITION"',
        'id="o" category="EVENT" type="POSITION"',
        'id="o" category="SAMPLE" type="POSITION" subType="PROGRAMMED" units="MILLIMETER"',
        'id="o" category="SAMPLE" type="POSITION" subType="ACTUAL" units="DEGREE"',
        'id="o" category="SAMPLE" type="ANGLE" subType="ACTUAL" units="DEGREE"',
    ],
)
@pytest.mark.parametrize("machine", ['coordinateSystemIdRef="mc"', 'coordinateSystem="MACHINE"'])
def test_the_machine_position_is_taken_whatever_stands_beside_it(other, machine):
    wanted = f'id="m" {GOOD} {machine}'
    assert chosen(model(other, wanted)) == chosen(model(wanted, other)) == "m"


@pytest.mark.parametrize(
    ("item", "component", "why"),
    [
        (f'id="o" {GOOD} coordinateSystemIdRef="wc"', "Linear", "OBJECT coordinates"),
        (f'id="o" {GOOD} coordinateSystemIdRef="nowhere"', "Linear", "does not define"),
        (f'id="o" {GOOD} representation="DATA_SET"', "Linear", "DATA_SET"),
        ('id="o" category="SAMPLE" type="POSITION"', "Linear", "no unit"),
        (f'id="o" {GOOD.replace("METER", "METER_3D")}', "Linear", "MILLIMETER_3D, expected"),
        (f'id="o" {GOOD} coordinateSystem=""', "Linear", "untold coordinates"),
        ('id="o" category="SAMPLE" type="ANGLE" units="MILLIMETER"', "Rotary", "MILLIMETER"),
        (f'id="o" {GOOD}', "Rotary", "has a ANGLE"),
    ],
)
def test_an_axis_without_a_sure_position_is_unusable_and_says_why(item, component, why):
    device = read_device(model(item, component=component), "")
    assert why in device.unusable["X"]
    assert [i.axis for i in device.items.values()] == ["Y"]


def test_two_positions_that_nothing_tells_apart_are_not_taken_by_their_order():
    device = read_device(model(f'id="a" {GOOD}', f'id="b" {GOOD}'), "")
    assert "a, b" in device.unusable["X"]


def test_an_axis_of_which_only_the_command_is_told_is_named_not_dropped():
    device = read_device(model(f'id="o" {GOOD.replace("ACTUAL", "COMMANDED")}'), "")
    assert device.unusable == {"X": "only the commanded position is told"}


SHIFTED = """<CoordinateSystem id="{id}" type="MACHINE" parentIdRef="mc"><Transformation>
<Translation>10 20 30</Translation></Transformation></CoordinateSystem>
<CoordinateSystem id="mc" type="MACHINE" parentIdRef="earth"/>
<CoordinateSystem id="earth" type="WORLD"/>"""


def test_a_machine_system_within_another_is_not_the_machines_own(monkeypatch):
    monkeypatch.setitem(globals(), "SYSTEMS", SHIFTED.format(id="shifted"))
    shifted = f'id="s" {GOOD} coordinateSystemIdRef="shifted"'
    assert "MACHINE in mc coordinates" in read_device(model(shifted), "").unusable["X"]
    assert chosen(model(shifted, f'id="m" {GOOD} coordinateSystemIdRef="mc"')) == "m"


def test_coordinate_systems_that_lie_in_each_other_end(monkeypatch):
    loop = '<CoordinateSystem id="mc" type="MACHINE" parentIdRef="a"/>'
    loop += '<CoordinateSystem id="a" type="WORLD" parentIdRef="mc"/>'
    monkeypatch.setitem(globals(), "SYSTEMS", loop)
    assert chosen(model(f'id="m" {GOOD} coordinateSystemIdRef="mc"')) == "m"


def test_of_the_tool_points_of_two_paths_none_is_taken_by_its_order():
    point = (
        'category="SAMPLE" type="PATH_POSITION" units="MILLIMETER_3D" coordinateSystem="MACHINE"'
    )
    paths = "".join(
        f'<Path><DataItems><DataItem id="{name}" {point}/></DataItems></Path>' for name in "pq"
    )
    axis = f'id="o" {GOOD} coordinateSystem="WORK"'
    text = model(axis, more=paths)
    assert {i.role for i in read_device(text, "").items.values()} == {"measured"}
    with pytest.raises(InputError, match="p, q: the model does not say which tool point"):
        read_device(
            text.replace(b'<Linear id="y"', b'<Other id="y"').replace(
                b"</Linear><Path", b"</Other><Path"
            ),
            "",
        )


def test_two_axes_of_one_name_are_told_apart_by_their_ids():
    second = '<Linear id="d" name="X"><DataItems><DataItem id="b" {}/></DataItems></Linear>'
    device = read_device(model(f'id="a" {GOOD}', more=second.format(GOOD)), "")
    assert {item.axis for item in device.items.values()} == {"X@c", "X@d", "Y"}
    assert "2 axes X" in device.notes[0]
    bad = read_device(model(f'id="a" {GOOD}', more=second.format('type="POSITION"')), "")
    assert {item.axis for item in bad.items.values()} == {"X@c", "Y"}
    assert list(bad.unusable) == ["X@d"]


@pytest.mark.parametrize(("system", "taken"), [("", False), ('coordinateSystem="WORK"', False),
                                               ('coordinateSystem="MACHINE"', True)])  # fmt: skip
def test_a_tool_point_is_taken_in_machine_coordinates_only(system, taken):
    item = (
        f'<DataItem id="p" category="SAMPLE" type="PATH_POSITION" units="MILLIMETER_3D" {system}/>'
    )
    path = f"<Path><DataItems>{item}</DataItems></Path>"
    assert ("p" in read_device(model(f'id="a" {GOOD}', more=path), "").items) is taken


def test_a_tool_point_in_the_place_of_axes_is_told(monkeypatch):
    point = '<DataItem id="tp" category="SAMPLE" type="PATH_POSITION" units="MILLIMETER_3D"'
    probe = mtconnect_agent.PROBE.replace("Linear", "Other").replace("Rotary", "Other")
    path = 'id="p"><DataItems>'
    probe = probe.replace(path, f'{path}{point} coordinateSystem="MACHINE"/>')
    monkeypatch.setattr(mtconnect_agent, "PROBE", probe)
    monkeypatch.setitem(mtconnect_agent.TAGS, "tp", "PathPosition")
    with Agent() as agent:
        agent.tell(avail="AVAILABLE", tp="1.5 2 -3")
        control = MtConnectControl(agent.url, rate_hz=100)
        control.connect()
        sample = control.read(3.0)[-1]
        control.close()
    assert sample.positions == {"X": 1.5, "Y": 2.0, "Z": -3.0}
    (note,) = sample.notes
    assert "no axes" in note


@pytest.mark.parametrize("text", ["", "1,5", "nan", "1.0 2.0 3.0", "TRUE"])
def test_text_that_is_no_number_makes_the_axis_unusable_and_ends_nothing(text):
    with Agent() as agent:
        agent.tell(avail="AVAILABLE", xa=text, ya=-2, ba=90)
        control = MtConnectControl(agent.url, rate_hz=100)
        control.connect()
        (first, *_) = control.read(3.0)
        agent.tell(xa=5.0)
        while "X" not in (last := control.read(3.0)[-1]).positions:
            pass
        control.close()
    assert "is not a number" in first.unusable["X"]
    assert first.positions["Y"] == -2.0
    assert (last.positions["X"], dict(last.unusable)) == (5.0, {})


def test_an_agent_is_not_asked_for_more_than_it_keeps():
    with Agent(size=16, strict=True) as agent:
        agent.tell(avail="AVAILABLE", xa=1.0, ya=-2, ba=90)
        control = MtConnectControl(agent.url, rate_hz=100)
        control.connect()
        assert control.read(3.0)[-1].positions["X"] == 1.0
        control.close()


def test_a_refused_stream_is_told_in_the_agents_words():
    words = r"OUT_OF_RANGE: 'count' must be less than"
    with (
        Agent(size=16, strict=True, refuse=True) as agent,
        pytest.raises(DeviceError, match=words),
    ):
        MtConnectControl(agent.url, rate_hz=100).connect()
