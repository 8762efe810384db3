"""A plan's seconds are those of the simulated machine's moves."""

import numpy as np
import pytest

from omm_core.planning.timing import rest_to_rest_s
from omm_simulation.motion import rest_to_rest


@pytest.mark.parametrize("seed", range(40))
def test_a_planned_move_takes_as_long_as_the_simulated_one(seed):
    random = np.random.default_rng(seed)
    length, velocity, acceleration, jerk = 10.0 ** random.uniform([0, 1, 2, 3], [3.5, 3, 4, 5])
    profile = rest_to_rest(
        velocity=velocity / length, acceleration=acceleration / length, jerk=jerk / length
    )
    planned = rest_to_rest_s(length, velocity, acceleration, jerk)
    assert planned == pytest.approx(profile.duration_s, rel=1e-9)
