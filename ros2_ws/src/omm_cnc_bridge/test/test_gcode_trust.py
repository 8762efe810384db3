"""Nothing gets into a program but checked words and numbers."""

import math

import numpy as np
import pytest

from omm_cnc_bridge.gcode import ProgramOptions, Stop, measuring_program
from omm_core.errors import InputError

STOPS = (Stop(target_id=1, spindle_in_machine_mm=np.zeros(3)),)


def test_a_name_cannot_become_a_command() -> None:
    text = measuring_program(STOPS, np.eye(3), ProgramOptions(), title="x)\nG53 G0 Z-500\n(")
    assert not [line for line in text.splitlines() if line.startswith("G53") and "Z-500" in line]
    assert text.splitlines()[1].count(")") == 1


@pytest.mark.parametrize("feed", [math.nan, math.inf, -5.0, 0.0])
def test_a_feed_that_no_machine_has_is_refused(feed: float) -> None:
    with pytest.raises(InputError, match="feed"):
        measuring_program(STOPS, np.eye(3), ProgramOptions(feed_mm_per_min=feed))


def test_a_negative_distance_is_refused() -> None:
    with pytest.raises(InputError, match="distance"):
        measuring_program(STOPS, np.eye(3), ProgramOptions(distance_mm=-1.0))
