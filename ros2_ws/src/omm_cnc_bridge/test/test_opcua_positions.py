"""Which of an axis's positions is believed, and which axes are none."""

import math

import pytest

pytest.importorskip("asyncua", reason="asyncua is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

from asyncua import ua  # noqa: E402
from opcua_server import OpcUaTestServer  # noqa: E402
from test_opcua import free_port, read  # noqa: E402

from omm_cnc_bridge.controls.opcua.control import OpcUaControl  # noqa: E402
from omm_cnc_bridge.controls.opcua.two_measurements import (  # noqa: E402
    AxisReading,
    OneMeasurement,
    TwoMeasurements,
)


def reading(actual, commanded=None):
    return AxisReading(actual=actual, commanded=commanded, why_not="BadNotSupported")


def choice(direct, indirect):
    """What is chosen after a run of pairs."""
    watch = TwoMeasurements(rotary=False)
    for pair in zip(direct, indirect, strict=True):
        last = watch.choose(*pair)
    return last.name


@pytest.mark.parametrize(
    ("direct", "indirect", "name"),
    [
        ([reading(100.0)], [reading(100.02)], "PosDirect"),
        ([reading(None)], [reading(100.0)], "PosIndirect"),
        ([reading(100.0)], [reading(None)], "PosDirect"),
        ([reading(None)], [reading(None)], ""),
        ([reading(0.0)], [reading(100.0, 100.0)], "PosIndirect"),
        ([reading(100.0, 100.0)], [reading(0.0)], "PosDirect"),
        ([reading(0.0)], [reading(100.0)], ""),
        ([reading(0.0)], [reading(0.3)], ""),
        ([reading(0.0)], [reading(0.005)], "PosDirect"),
        ([reading(0.0), reading(0.0)], [reading(0.3), reading(0.4)], "PosIndirect"),
        ([reading(0.4), reading(0.0)], [reading(0.7), reading(0.3)], "PosDirect"),
        ([reading(0.0)], [reading(100.0, 250.0)], ""),
        ([reading(50.0, 50.0)], [reading(100.0, 100.0)], ""),
        ([reading(0.0), reading(0.0)], [reading(0.0), reading(0.1)], "PosIndirect"),
        ([reading(7.0), reading(7.0)], [reading(0.0), reading(30.0)], "PosIndirect"),
        ([reading(0.0), reading(0.1)], [reading(0.0), reading(0.0)], "PosDirect"),
        ([reading(1.0), reading(2.0)], [reading(1.0), reading(9.0)], ""),
    ],
)
def test_a_position_is_believed_for_what_it_does_not_for_being_there(direct, indirect, name):
    assert choice(direct, indirect) == name


@pytest.mark.parametrize(
    ("pairs", "believed"),
    [
        ([(0.0, 100.0)], False),
        ([(0.0, 0.0), (0.0, 100.0)], False),
        ([(0.0, 0.0), (0.0, 0.4)], True),
        ([(5.0, 5.0), (0.0, 100.0)], True),
        ([(0.0, 100.0), (0.1, 100.0), (0.0, 100.0)], True),
        ([(0.0, None)], True),
    ],
)
def test_the_only_position_is_not_believed_where_it_is_a_bare_zero(pairs, believed):
    watch = OneMeasurement(rotary=False)
    why = [watch.refusal(reading(*pair)) for pair in pairs][-1]
    assert (why == "") is believed


def test_an_axis_with_a_dead_scale_only_is_unusable_until_it_is_seen_to_measure():
    with make_server() as server:
        server.positions, server.commanded = AT | {"X": 0.0}, AT
        control = OpcUaControl(server.url, rate_hz=50)
        control.connect()
        first = read(control, 5.0, lambda s: True)[-1]
        server.positions = AT
        last = read(control, 5.0, lambda s: "X" in s.positions)[-1]
        control.close()
    assert "commanded to 100.0000 mm" in first.unusable["X"]
    assert set(first.positions) == {"Y", "B"}
    assert (last.positions["X"], dict(last.unusable)) == (100.0, {})


def heard(server, seconds=5.0, until=lambda s: True):
    control = OpcUaControl(server.url, rate_hz=50)
    try:
        control.connect()
        return read(control, seconds, until)[-1]
    finally:
        control.close()


def make_server(**settings):
    server = OpcUaTestServer(free_port())
    for name, value in settings.items():
        setattr(server, name, value)
    return server


AT = {"X": 100.0, "Y": 50.0, "B": 90.0}


def test_a_scale_that_is_not_there_is_seen_by_the_motor_that_moves():
    with make_server(indirect=dict(AT)) as server:
        server.positions = server.commanded = dict.fromkeys(AT, 0.0)
        control = OpcUaControl(server.url, rate_hz=50)
        control.connect()
        first = read(control, 5.0, lambda s: True)[-1]
        server.indirect = {"X": 101.0, "Y": 51.0, "B": 91.0}
        last = read(control, 5.0, lambda s: s.positions.get("X") == 101.0)[-1]
        control.close()
    assert first.positions == {}
    assert "PosDirect says 0.0000 mm and PosIndirect 100.0000 mm" in first.unusable["X"]
    assert last.positions == pytest.approx({"X": 101.0, "Y": 51.0, "B": math.radians(91.0)})
    assert any("axis X: PosIndirect is used" in note for note in last.notes)


def test_a_direct_position_that_is_not_supported_gives_way_to_the_indirect():
    settings = {"indirect": dict(AT), "direct_quality": ua.StatusCodes.BadNotSupported}
    with make_server(**settings) as server:
        last = heard(server, until=lambda s: len(s.positions) == 3)
    assert last.positions == pytest.approx({"X": 100.0, "Y": 50.0, "B": math.pi / 2})
    assert any("BadNotSupported" in note for note in last.notes)


@pytest.mark.parametrize(("told", "referenced"), [(1, True), (0, False), ("no", False)])
def test_only_a_yes_says_that_an_axis_is_referenced(told, referenced):
    """Controls say it as a number, too, and 0 is not False to Python's ``is``."""
    with make_server(referenced=told) as server:
        last = heard(server)
    assert ("X" in last.unusable) is not referenced
    assert referenced or "is not referenced" in last.unusable["X"]


@pytest.mark.parametrize("mark", ["IsVirtual", "IsInactive"])
def test_an_axis_that_the_control_marks_as_none_blocks_nothing(mark):
    with make_server(more={"V": {"PosDirect": None, mark: True}}) as server:
        last = heard(server, until=lambda s: not s.unusable)
    assert set(last.positions) == {"X", "Y", "B"}
    assert last.fault is None


def test_an_axis_without_a_unit_is_unusable_and_the_others_are_not():
    with make_server(more={"A": {"PosDirect": 5.0}}) as server:
        last = heard(server)
    assert "tells no unit" in last.unusable["A"]
    assert set(last.positions) == {"X", "Y", "B"}
