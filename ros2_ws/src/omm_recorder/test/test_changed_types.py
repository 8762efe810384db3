"""A recording of an earlier version is replayed as messages of today."""

from typing import Any

import numpy as np
import pytest
from omm_interfaces.msg import PartEstimate, SpindleState
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from omm_recorder.conversions import as_installed
from omm_recorder.definitions import definition, fields_of
from omm_recording.decoding import decoder

NEW = {
    "omm_interfaces/msg/SpindleState": ("connection_said", "moving_said"),
    "omm_interfaces/msg/PartEstimate": (
        "share_sources", "shares", "missing_said", "findings_said", "remarks_said",
        "revoked_said", "reason_said", "pending",
    ),
}  # fmt: skip


def earlier(type_name: str) -> str:
    """The definition before what is said had keys."""
    lines = definition(type_name).splitlines(keepends=True)
    new = NEW[type_name]
    kept = [line for line in lines if not any(f" {name} " in f" {line} " for name in new)]
    return "".join(kept)


def recorded(type_name: str, **values: Any) -> Any:
    """A message as its earlier definition decodes it."""
    store = get_typestore(Stores.EMPTY)
    text = earlier(type_name)
    store.register(get_types_from_msg(text, type_name))
    message = store.types[type_name](**values)
    return decoder(type_name, "ros2msg", text)(bytes(store.serialize_cdr(message, type_name)))


@pytest.mark.parametrize("type_name", NEW)
def test_definitions_differ_by_their_fields_and_by_nothing_else(type_name: str) -> None:
    today = definition(type_name)
    commented = today.replace("\n", "   # a remark\n\n")
    assert fields_of(commented) == fields_of(today)
    assert fields_of(earlier(type_name)) != fields_of(today)


def _header(store: Any) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=5, nanosec=7)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id="machine")


def test_a_state_of_an_earlier_version_keeps_all_that_it_said() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    old = recorded(
        "omm_interfaces/msg/SpindleState",
        header=_header(store), control="linuxcnc", connection=2, connection_detail="", mode=3,
        program_state=2, program="a.ngc", program_line=7, axis_names=["X", "Y"],
        axis_positions=np.array([0.1, 0.2]), axis_commanded=np.array([0.1, 0.25]),
        in_position=False, moving_reason="first sample", measure_requested=True,
        measure_request=4, measure_acknowledged=3, stamp_uncertainty=0.001,
        spindle_orientation=0, spindle_angle=1.5,
        **{f"{a}_{b}": n for a, names in (
            ("CONNECTION", ("DISCONNECTED", "CONNECTING", "CONNECTED", "STALE")),
            ("MODE", ("UNKNOWN", "MANUAL", "MDI", "AUTOMATIC")),
            ("PROGRAM", ("UNKNOWN", "STOPPED", "RUNNING", "WAITING", "INTERRUPTED", "FINISHED")),
            ("ORIENTATION", ("UNKNOWN", "FREE", "TURNING", "HELD", "FAULT")),
        ) for n, b in enumerate(names)},
    )  # fmt: skip
    message = as_installed(SpindleState, old)
    assert (message.header.stamp.sec, message.header.frame_id) == (5, "machine")
    assert list(message.axis_positions) == [0.1, 0.2]
    assert list(message.axis_names) == ["X", "Y"]
    assert (message.moving_reason, message.moving_said) == ("first sample", "")
    assert (message.measure_request, message.spindle_angle) == (4, 1.5)


def test_nested_messages_are_taken_over_as_well() -> None:
    class Stamp:
        sec, nanosec = 3, 9

    class Image:
        stamp, used, reason = Stamp(), True, "why"

    class Estimate:
        def __init__(self) -> None:
            self.part, self.images, self.theta = "bed", [Image()], np.arange(7.0)
            self.missing = ["a", "b"]

    message = as_installed(PartEstimate, Estimate())
    assert (message.images[0].stamp.sec, message.images[0].reason) == (3, "why")
    assert list(message.theta) == list(range(7))
    assert (list(message.missing), list(message.missing_said)) == (["a", "b"], [])
