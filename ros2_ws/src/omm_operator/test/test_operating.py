"""What commands do; that a control refuses or keeps something else is told, and stays."""

import asyncio
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from omm_core.files.part import Part
from omm_core.files.wishes import Jack
from omm_operator.operating import Operation, Refused
from omm_operator.screen.commands import Command
from omm_operator.screen.desk import Answer, Asker
from omm_operator.screen.facts import ControlFact, EstimateFact, HealthFact, OffsetFact
from omm_operator.screen.handing import HandingOptions
from omm_operator.screen.screen import Screen

OPERATOR = Asker(who="127.0.0.1 a", role="operator")
FEET = ((0.0, 0.0), (1000.0, 0.0), (0.0, 800.0))
PART = Part(
    name="bed",
    target_family="aicon12",
    targets=(),
    box_mm=np.array([[0.0, 0.0, 0.0], [1500.0, 1000.0, 500.0]]),
    jacks=tuple(Jack(name=f"J{k}", xyz_mm=np.array([*xy, 0.0])) for k, xy in enumerate(FEET)),
)


class Cell:
    """Nodes that do as they are asked, unless they are told otherwise."""

    def __init__(self) -> None:
        self.offset = OffsetFact(name="G54", xyz_mm=(0.0, 0.0, 0.0), euler_xyz_rad=(0.0, 0.0, 0.0))
        self.written: list[OffsetFact] = []
        self.refuses = ""
        self.off_mm = 0.0
        self.recorded: list[tuple[str, Any]] = []
        self.screen = Screen(options=HandingOptions(), wall_ns=time.time_ns, clock_s=time.monotonic)
        self.operation = Operation(self.screen, self, self._record)

    def _record(self, asker: Asker, command: Command, answer: Answer | None) -> None:
        self.recorded.append((command.name, answer and (answer.accepted, dict(answer.more))))

    async def start_program(self) -> None:
        self._refuse()

    async def new_clamping(self) -> None:
        self._refuse()

    async def work_offset(self, name: str, wanted: OffsetFact | None) -> OffsetFact:
        if wanted is not None:
            self._refuse()
            self.written.append(wanted)
            x, y, z = wanted.xyz_mm
            self.offset = replace(wanted, xyz_mm=(x + self.off_mm, y, z))
        return self.offset

    async def report(self, language: str) -> bytes:
        self._refuse()
        return b"%PDF-"

    def _refuse(self) -> None:
        if self.refuses:
            raise Refused(self.refuses)

    def give(self, name: str, **arguments: object) -> Answer:
        command = Command(name=name, key=f"key-{len(self.recorded):08d}", arguments=arguments)
        return asyncio.run(self.operation.desk.take(OPERATOR, command))


@pytest.fixture
def cell() -> Cell:
    """A cell in which everything is well and the part was measured, 4 mrad about Z."""
    made = Cell()
    screen = made.screen
    screen.take_part_or_why(PART)
    screen.take_allowed(True)
    for node, name in (("estimator", "images"), ("camera", "connection")):
        screen.take_health(HealthFact(node=node, name=name, level=0, message=""))
    screen.take_control(
        ControlFact(control="linuxcnc", connection=2, program_state=1, in_position=True)
    )
    screen.take_estimate(
        EstimateFact(
            part="bed",
            determined=True,
            converged=True,
            theta=np.array([1e-5, 0.0, 4e-3, 812.345, -410.25, 155.02, 0.0]),
            covariance=np.eye(7) * 1e-12,
            expanded_uncertainty=np.full(7, 2e-6),
            stamp_ns=time.time_ns(),
        )
    )
    return made


def test_what_is_handed_over_is_the_pose_read_back_and_recorded(cell: Cell) -> None:
    assert cell.give("hand_over").accepted
    (written,) = cell.written
    assert written.euler_xyz_rad == pytest.approx((0.0, 0.0, 4e-3), abs=1e-9)
    handed = cell.screen.snapshot()["hand"]["handed"]
    assert handed["equal"] is True
    assert handed["old"]["xyz_mm"] == [0.0, 0.0, 0.0]
    assert cell.recorded[0] == ("hand_over", None)
    accepted, more = cell.recorded[1][1]
    assert (accepted, more["new"]["xyz_mm"]) == (True, list(written.xyz_mm))


def test_a_control_that_keeps_something_else_is_told_loudly(cell: Cell) -> None:
    cell.off_mm = 0.001
    answer = cell.give("hand_over")
    assert not answer.accepted
    assert answer.said.key == "said.reads_other"
    assert cell.screen.snapshot()["hand"]["handed"]["equal"] is False
    assert [t.said.key for t in cell.screen.troubles.all()] == ["trouble.refused_hand_over"]


@pytest.mark.parametrize("name", ["hand_over", "start_program", "new_clamping"])
def test_what_a_control_refuses_is_answered_with_its_reason_and_stays(
    cell: Cell, name: str
) -> None:
    cell.refuses = "the machine is not at rest: X is 0.0200 mm away from its command"
    answer = cell.give(name)
    assert not answer.accepted
    assert answer.said.key == "said.not_at_rest"
    (trouble,) = cell.screen.troubles.all()
    assert trouble.said.key == f"trouble.refused_{name}"
    assert trouble.detail is not None
    assert "X is 0.0200 mm" in trouble.detail.in_language("en")


def test_a_correction_is_recorded_as_it_was_shown(cell: Cell) -> None:
    shown = cell.screen.snapshot()["correct"]["modes"]["tilt"]
    assert cell.give("corrected", mode="tilt").accepted
    _, more = cell.recorded[1][1]
    assert [jack["mm"] for jack in more["jacks"]] == [jack["mm"] for jack in shown]
    assert [(jack["x_mm"], jack["y_mm"]) for jack in more["jacks"]] == list(FEET)


def test_nothing_is_written_once_the_pose_no_longer_holds(cell: Cell) -> None:
    held = cell.screen.kept.estimate
    assert held is not None
    cell.screen.take_estimate(replace(held, revoked=True, determined=False))
    assert not cell.give("hand_over").accepted
    assert cell.written == []
