"""A plan's picture: labels that would lie on each other share one."""

import numpy as np

from omm_report.plan_picture import together


def test_places_that_lie_near_each_other_share_a_label_and_none_is_lost() -> None:
    places = np.array([[0.0, 0.0], [100.0, 0.0], [1.0, 1.0], [100.0, 30.0], [0.0, 2.0]])
    labels = together(places, ["a", "b", "c", "d", "e"], near=5.0)
    assert labels == [((0.0, 0.0), "a, c, e"), ((100.0, 0.0), "b"), ((100.0, 30.0), "d")]
