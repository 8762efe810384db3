"""What is written into a program comes from a checked alphabet and range."""

import math
import re

import numpy as np
import pytest
from test_gcode_first_moves import measuring_program

from omm_core.errors import InputError
from omm_core.planning.pattern import Stop
from omm_core.planning.program import ProgramOptions

STOPS = (Stop(target_id=42, spindle_in_machine_mm=np.array([1.0, 2.0, 3.0])),)


def blocks(title: str) -> list[str]:
    """The program without its comments."""
    program = measuring_program(STOPS, np.eye(3), ProgramOptions(), title=title)
    assert program.isascii()
    return [re.sub(r"\([^()\n]*\)", "", line) for line in program.splitlines()]


@pytest.mark.parametrize(
    "name",
    ["bench)\nG53 G0 Z-500 (raw part", "a\rG0 Z-500", "%", "(MSG,x)", "x;G0 Z-500", "Gehäuse\x00"],
)
def test_a_parts_name_changes_nothing_but_a_comment(name: str) -> None:
    assert blocks(name) == blocks("bench")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -5.0, 0.0])
@pytest.mark.parametrize("field", ["feed_mm_per_min", "answer_timeout_s", "tries"])
def test_a_number_that_no_machine_should_be_given_is_refused(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        ProgramOptions(**{field: value})


def test_a_place_that_is_no_number_is_refused() -> None:
    nowhere = (Stop(target_id=42, spindle_in_machine_mm=np.array([1.0, math.nan, 3.0])),)
    with pytest.raises(InputError, match="target 42"):
        measuring_program(nowhere, np.eye(3), ProgramOptions())
