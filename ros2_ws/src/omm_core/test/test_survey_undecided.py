"""Of few rays, which one is wrong cannot always be told: then the target is left out, and said."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from test_survey_network import SIZE, bars_of, photographs

from omm_core.errors import MeasurementError
from omm_core.survey import Bar, Network, Sighting, solve_network, weeding
from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.words import findings_of

Array = NDArray[np.float64]

PLACES = 9
FEW = (12, 15, 18)  # targets that four photographs show: from two places, the camera turned in one
FIRST, SECOND = 1, 4
SHOWN = {FIRST, FIRST + PLACES, SECOND, SECOND + PLACES}
SMALL_PX, LARGE_PX = 0.07, 0.3


def seen_from_two_places() -> tuple[Array, list[Sighting], Network]:
    points, sightings = photographs(np.random.default_rng(3), PLACES)
    clean = solve_network(sightings, bars_of(points), 3010.0, SIZE)
    few = [s for s in sightings if s.point not in FEW or s.photo in SHOWN]
    return points, few, clean


def along_the_other_ray(clean: Network, point: int) -> Array:
    """Where a point goes in the first photograph that moves along its ray in the second one."""
    place = clean.xyz_mm(point)
    look = place - clean.pose(SECOND)[3:]
    values = {**clean.solution.values, "points": np.array([place, place + 1e-3 * look])}
    rows = np.full(2, clean.photos[FIRST])
    here, there = evaluate_rays(values, rows, np.arange(2), clean.middle_px)[0]
    return (there - here) / np.linalg.norm(there - here)


def with_wrong_rays(sightings: list[Sighting], off_px: dict[int, Array]) -> list[Sighting]:
    return [
        replace(s, center_px=s.center_px + off_px[s.point])
        if s.photo == FIRST and s.point in off_px
        else s
        for s in sightings
    ]


def test_a_target_is_left_out_where_the_others_do_not_tell_which_ray_is_wrong(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points, sightings, clean = seen_from_two_places()
    wrong = {n: SMALL_PX * along_the_other_ray(clean, n) for n in FEW}
    spoilt = with_wrong_rays(sightings, wrong)
    network = solve_network(spoilt, bars_of(points), 3010.0, SIZE)
    assert set(network.left_out_points) == set(FEW)
    assert any("1 of its 4 rays is wrong" in why for why in network.left_out_points.values())
    assert not network.left_out_photos
    monkeypatch.setattr(weeding, "undecided_points", lambda _: {})
    blind = solve_network(spoilt, bars_of(points), 3010.0, SIZE)
    chosen = [
        s.photo
        for s, used in zip(blind.sightings, blind.used, strict=True)
        if s.point in FEW and not used
    ]
    assert set(chosen) - {FIRST}  # what is prevented: a good ray is left out


def test_no_target_is_lost_without_a_word() -> None:
    points, sightings, clean = seen_from_two_places()
    wrong = {n: LARGE_PX * along_the_other_ray(clean, n) for n in FEW}
    sightings = [s for s in sightings if s.point != 10 or s.photo == FIRST]
    sightings = [s for s in sightings if s.point != 11 or s.photo in (FIRST, SECOND)]
    network = solve_network(with_wrong_rays(sightings, wrong), bars_of(points), 3010.0, SIZE)
    assert set(network.left_out_points) == set(FEW)
    told = findings_of(network, str, [3010.0])
    assert sum("rays" in words and "left out" in words for words in told) == len(FEW)
    (few,) = [words for words in told if "fewer than 3 rays" in words]
    assert "10" in few
    assert "11" in few


def test_a_wrong_ray_that_the_others_tell_costs_no_target() -> None:
    points, sightings, clean = seen_from_two_places()
    wrong = {n: LARGE_PX * along_the_other_ray(clean, n)[::-1] * [1, -1] for n in FEW}
    network = solve_network(with_wrong_rays(sightings, wrong), bars_of(points), 3010.0, SIZE)
    assert not network.left_out_points
    out = [s for s, used in zip(network.sightings, network.used, strict=True) if not used]
    assert sorted(s.point for s in out) == sorted(FEW)
    assert {s.photo for s in out} == {FIRST}


def test_targets_of_four_good_rays_stay() -> None:
    points, sightings, _ = seen_from_two_places()
    network = solve_network(sightings, bars_of(points), 3010.0, SIZE)
    assert set(FEW) <= set(network.points)
    assert not network.left_out_points


def test_a_survey_whose_only_bar_ends_at_such_a_target_is_refused() -> None:
    points, sightings, clean = seen_from_two_places()
    wrong = {FEW[0]: SMALL_PX * along_the_other_ray(clean, FEW[0])}
    length_mm = float(np.linalg.norm(points[0] - points[FEW[0]]))
    bar = Bar(ends=(0, FEW[0]), length_mm=length_mm, sigma_mm=0.002)
    with pytest.raises(MeasurementError, match=f"no scale: target {FEW[0]}, .*left out"):
        solve_network(with_wrong_rays(sightings, wrong), [bar], 3010.0, SIZE)
