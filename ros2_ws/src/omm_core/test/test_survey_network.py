"""A network of photographs gives back the points that it was made of."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omm_core.errors import MeasurementError
from omm_core.survey import Bar, Network, Sighting, coded_network, solve_network
from omm_core.survey.camera_model import evaluate_rays, turn_and_shift
from omm_core.survey.misreading import misread_targets
from omm_core.survey.words import findings_of

LENS = np.array([3010.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 1e-4, 2e-5])
SIZE = (3000, 2000)
SIGMA_PX = 0.01


def photographs(rng: np.random.Generator, places: int = 18) -> tuple[np.ndarray, list[Sighting]]:
    """Points seen in 18 photographs; from each of 9 places two are taken, the camera turned."""
    points = rng.uniform(-1, 1, (20, 3)) * [400.0, 300.0, 150.0]
    photos = []
    for i in range(18):
        around = 2 * np.pi * i / places
        place = np.array([1300 * np.cos(around), 1300 * np.sin(around), 1100.0 + 100 * (i % 3)])
        z = -place / np.linalg.norm(place)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        roll = Rotation.from_rotvec([0, 0, np.pi / 2 * (i % 4)]).as_matrix()
        turn = roll @ np.array([x, np.cross(z, x), z])
        photos.append(np.r_[Rotation.from_matrix(turn).as_rotvec(), place])
    photo, point = (grid.ravel() for grid in np.mgrid[:18, :20])
    values = {"lens": LENS[None], "photos": np.array(photos), "points": points}
    pixels, _ = evaluate_rays(values, photo, point, (np.array(SIZE) - 1) / 2)
    pixels += rng.normal(0, SIGMA_PX, pixels.shape)
    return points, [
        Sighting(photo=int(i), point=int(p), center_px=c, covariance_px2=SIGMA_PX**2 * np.eye(2))
        for i, p, c in zip(photo, point, pixels, strict=True)
    ]


def bars_of(points: np.ndarray) -> list[Bar]:
    return [
        Bar(ends=(a, b), length_mm=float(np.linalg.norm(points[a] - points[b])), sigma_mm=0.002)
        for a, b in ((0, 1), (2, 3))
    ]


def with_moved(
    sightings: list[Sighting],
    clean: Network,
    numbers: set[int],
    photos: range,
    by_mm: list[float],
) -> list[Sighting]:
    """What was seen, where targets stood somewhere else in some photographs."""
    values = clean.solution.values
    shifted = {**values, "points": values["points"] + by_mm}
    moved = []
    for s in sightings:
        if s.point in numbers and s.photo in photos:
            rows = (np.array([clean.photos[s.photo]]), np.array([clean.points[s.point]]))
            there, here = (
                evaluate_rays(v, *rows, clean.middle_px)[0][0] for v in (shifted, values)
            )
            s = replace(s, center_px=s.center_px + there - here)
        moved.append(s)
    return moved


def test_coordinates_err_as_much_as_their_covariance_says_and_blunders_are_left_out() -> None:
    points, sightings = photographs(np.random.default_rng(7))
    moved = sightings[33]
    sightings[33] = Sighting(
        photo=moved.photo, point=moved.point, center_px=moved.center_px + [3.0, -2.0],
        covariance_px2=moved.covariance_px2,
    )  # fmt: skip
    network = solve_network(sightings, bars_of(points), 3060.0, SIZE)
    assert not network.used[33]
    assert network.sigma0 == pytest.approx(1.0, abs=0.15)
    found = network.solution.values["points"]
    turn, _ = Rotation.align_vectors(points - points.mean(0), found - found.mean(0))
    errors = turn.inv().apply(points - points.mean(0)) - (found - found.mean(0))
    sigma2 = np.diag(network.solution.covariance_of("points")).reshape(-1, 3)
    assert 0.5 < np.mean(errors**2 / sigma2) < 1.7


def test_a_target_that_moved_is_named_and_left_out_and_harms_no_other() -> None:
    points, sightings = photographs(np.random.default_rng(11))
    clean = solve_network(sightings, bars_of(points), 3010.0, SIZE)
    # 2 is an end of a bar.
    moved = with_moved(sightings, clean, {2, 12}, range(0, 18, 3), [0.9, -0.7, 0.0])
    network = solve_network(moved, bars_of(points), 3010.0, SIZE)
    assert set(network.left_out_points) == {2, 12}
    assert [bar.ends for bar in network.bars] == [(0, 1)]
    assert "moved" in network.left_out_points[12]
    assert not network.left_out_photos
    sigma = np.sqrt(np.diag(clean.solution.covariance_of("points"))).reshape(-1, 3)
    there = np.array([network.xyz_mm(n) for n in network.points])
    wanted = np.array([clean.xyz_mm(n) for n in network.points])
    turn, _ = Rotation.align_vectors(wanted - wanted.mean(0), there - there.mean(0))
    away = np.abs(turn.apply(there - there.mean(0)) - (wanted - wanted.mean(0)))
    assert (away < 1.5 * sigma[[clean.points[n] for n in network.points]]).all()


def test_photographs_with_another_zoom_are_named_and_left_out() -> None:
    points, sightings = photographs(np.random.default_rng(12))
    middle = (np.array(SIZE) - 1) / 2
    zoomed = [
        replace(s, center_px=middle + 1.01 * (s.center_px - middle)) if s.photo >= 12 else s
        for s in sightings
    ]
    network = solve_network(zoomed, bars_of(points), 3060.0, SIZE)
    assert set(network.left_out_photos) == set(range(12, 18))
    assert all("zoom" in why for why in network.left_out_photos.values())
    assert network.lens[0] == pytest.approx(3010.0, abs=2.0)


def distances(network: Network, clean: Network) -> np.ndarray:
    """How far points lie from where the clean network has them, in its frame."""
    there, wanted = network.solution.values["points"], clean.solution.values["points"]
    turn, _ = Rotation.align_vectors(wanted - wanted.mean(0), there - there.mean(0))
    return np.abs(turn.apply(there - there.mean(0)) - (wanted - wanted.mean(0)))


def test_a_zoom_touched_by_a_thousandth_is_found_whichever_photographs_it_is_in() -> None:
    points, sightings = photographs(np.random.default_rng(16))
    middle = (np.array(SIZE) - 1) / 2
    zoomed = [
        replace(s, center_px=middle + 1.001 * (s.center_px - middle)) if 5 <= s.photo < 9 else s
        for s in sightings
    ]
    network = solve_network(zoomed, bars_of(points), 3010.0, SIZE)
    assert set(network.left_out_photos) == {5, 6, 7, 8}
    assert all("zoom" in why for why in network.left_out_photos.values())


def test_five_percent_of_blunders_of_any_size_change_no_point_by_more_than_its_sigma() -> None:
    points, sightings = photographs(np.random.default_rng(17))
    clean = solve_network(sightings, bars_of(points), 3010.0, SIZE)
    sigma = np.sqrt(np.diag(clean.solution.covariance_of("points"))).reshape(-1, 3)
    rng = np.random.default_rng(18)
    bad = rng.random(len(sightings)) < 0.05
    size_px = 10.0 ** rng.uniform(-0.5, 2.0, len(sightings))
    spoilt = [
        replace(s, center_px=s.center_px + size * rng.normal(size=2)) if b else s
        for s, b, size in zip(sightings, bad, size_px, strict=True)
    ]
    network = solve_network(spoilt, bars_of(points), 3010.0, SIZE)
    assert set(network.points) == set(clean.points)
    assert np.sum(~network.used & ~bad) <= 1  # of 360, at 4 sigma
    assert (distances(network, clean) < sigma).all()


def test_a_blunder_on_a_point_with_few_rays_costs_no_good_ray() -> None:
    points, sightings = photographs(np.random.default_rng(21))
    few = [s for s in sightings if s.point != 19 or 2 <= s.photo <= 6]
    spoilt = [
        replace(s, center_px=s.center_px + [0.15, 0.0]) if (s.photo, s.point) == (4, 19) else s
        for s in few
    ]
    network = solve_network(spoilt, bars_of(points), 3010.0, SIZE)
    out = [
        (s.photo, s.point)
        for s, used in zip(network.sightings, network.used, strict=True)
        if not used
    ]
    assert out == [(4, 19)]


@pytest.mark.parametrize(("seed", "share"), [(2, 0.5), (5, 0.5), (5, 0.35)])
def test_a_target_that_stands_far_away_in_half_of_its_photographs_is_left_out_by_name(
    seed: int, share: float
) -> None:
    random = np.random.default_rng(seed)
    points, every = photographs(random)
    clean = solve_network(every, bars_of(points), 3010.0, SIZE)
    moved = with_moved(every, clean, {12}, range(9, 18), [8.0, 6.0, 0.0])
    shown = [s for s in moved if s.point == 12 or random.random() <= share]
    network = solve_network(shown, bars_of(points), 3010.0, SIZE)
    assert "moved" in network.left_out_points[12]
    assert network.sigma0 == pytest.approx(1.0, abs=0.25)
    assert len(network.points) == 19


def test_a_step_of_the_start_that_nothing_holds_does_not_end_the_survey(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points, sightings = photographs(np.random.default_rng(22))
    # Photographs that show four targets wait until the lens is known: a second step.
    few = [s for s in sightings if s.photo != 17 or s.point < 4]
    real, failed = coded_network.adjusted, []

    def failing(*args: Any) -> Network:
        if len(args[0].photos) == 18 and not failed:
            failed.append(args)
            raise np.linalg.LinAlgError("not positive definite")
        return real(*args)

    monkeypatch.setattr(coded_network, "adjusted", failing)
    network = solve_network(few, bars_of(points), 3010.0, SIZE)
    assert failed
    assert set(network.photos) >= set(range(17))
    assert len(network.points) == 20


def test_numbers_swapped_in_three_photographs_are_named_and_harm_no_other() -> None:
    points, sightings = photographs(np.random.default_rng(19))
    clean = solve_network(sightings, bars_of(points), 3010.0, SIZE)
    other = {7: 9, 9: 7}
    swapped = [
        replace(s, point=other.get(s.point, s.point)) if s.photo < 3 else s for s in sightings
    ]
    network = solve_network(swapped, bars_of(points), 3010.0, SIZE)
    assert {(r.photo, r.read, r.is_target) for r in misread_targets(network)} == {
        (photo, *pair) for photo in range(3) for pair in ((7, 9), (9, 7))
    }
    sigma = np.sqrt(np.diag(clean.solution.covariance_of("points"))).reshape(-1, 3)
    others = np.delete(distances(network, clean) / sigma, (7, 9), axis=0)  # these have fewer rays
    assert (others < 0.5).all()
    told = findings_of(network, lambda n: f"photo {n}", [3010.0])
    assert any("photo 1" in words and "7" in words and "swapped" in words for words in told)


def test_without_a_measured_bar_there_is_no_scale() -> None:
    _, sightings = photographs(np.random.default_rng(8))
    bar = Bar(ends=(0, 99), length_mm=500.0, sigma_mm=0.01)
    with pytest.raises(MeasurementError, match="scale"):
        solve_network(sightings, [bar], 3060.0, SIZE)


def test_derivatives_are_those_of_the_projection() -> None:
    rng = np.random.default_rng(9)
    values = {
        "lens": LENS[None],
        "photos": np.array([[0.1, -0.2, 0.3, 5.0, 6.0, -900.0]]),
        "points": rng.uniform(-200, 200, (6, 3)),
    }
    photo, point, middle = np.zeros(6, dtype=int), np.arange(6), np.zeros(2)
    _, derivatives = evaluate_rays(values, photo, point, middle)
    for k, size in enumerate([1e-6] * 3 + [1e-3] * 3):
        step = np.zeros((1, 6))
        step[0, k] = size
        ends = [
            evaluate_rays(
                {**values, "photos": turn_and_shift(values["photos"], s)}, photo, point, middle
            )[0]
            for s in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / (2 * size)
        assert derivatives["photos"][:, :, k] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    for k in range(10):
        step = np.zeros((1, 10))
        step[0, k] = 1e-5
        ends = [
            evaluate_rays({**values, "lens": LENS[None] + s}, photo, point, middle)[0]
            for s in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / 2e-5
        assert derivatives["lens"][:, :, k] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_bars_that_contradict_each_other_are_refused_and_one_of_three_is_left_out() -> None:
    points, sightings = photographs(np.random.default_rng(13))
    wrong = replace(bars_of(points)[0], length_mm=bars_of(points)[0].length_mm + 0.5)
    with pytest.raises(MeasurementError, match="disagree"):
        solve_network(sightings, [wrong, bars_of(points)[1]], 3010.0, SIZE)
    doubtful = replace(wrong, length_mm=bars_of(points)[0].length_mm + 0.025)
    network = solve_network(sightings, [doubtful, bars_of(points)[1]], 3010.0, SIZE)
    assert len(network.bars) == 2
    (told,) = [words for words in findings_of(network, str, [3010.0]) if "bars" in words]
    assert "hardly agree" in told
    third = Bar(ends=(5, 9), length_mm=float(np.linalg.norm(points[5] - points[9])), sigma_mm=0.002)
    network = solve_network(sightings, [wrong, bars_of(points)[1], third], 3010.0, SIZE)
    assert [bar.ends for bar in network.bars] == [(2, 3), (5, 9)]
    assert "0-1" in network.words[0]


def test_a_focal_length_told_wrong_by_half_is_found() -> None:
    points, sightings = photographs(np.random.default_rng(14))
    network = solve_network(sightings, bars_of(points), 1.5 * 3010.0, SIZE)
    assert network.lens[0] == pytest.approx(3010.0, abs=2.0)


def test_photographs_that_have_nothing_in_common_end_in_words() -> None:
    points, sightings = photographs(np.random.default_rng(15))
    lonely = [s for s in sightings if s.photo < 3 and s.point % 3 == s.photo]
    with pytest.raises(MeasurementError):
        solve_network(lonely, bars_of(points), 3010.0, SIZE)
    with pytest.raises(MeasurementError, match="none was read"):
        solve_network([], bars_of(points), 3010.0, SIZE)
