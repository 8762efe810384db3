"""Placements of a block in its blank against exact answers."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from omm_core.overstock.placement import place_by_least_squares, place_evenly
from omm_core.overstock.wish import Balance, Wish

SIZE = np.array([1000.0, 400.0, 300.0])
# 36 mm and 27 mrad away.
TURN = Rotation.from_rotvec([0.015, -0.015, 0.017]).as_matrix()
SHIFT = np.array([20.0, -21.0, 21.0])
ASYMMETRIC = ((3, 7), (8, 2), (6, 4))


def blank(stock, counts=(16,) * 6, seed=1):
    """Return points on the blank, their faces, nominal normals and offsets."""
    random = np.random.default_rng(seed)
    points, faces, normals = [], [], []
    for axis in range(3):
        for side, sign in enumerate((-1.0, 1.0)):
            face = 2 * axis + side
            p = random.uniform(0.02, 0.98, (counts[face], 3)) * SIZE
            p[:, axis] = SIZE[axis] * side + sign * stock[axis][side]
            points.append(p)
            faces += [face] * counts[face]
            normals += [sign * np.eye(3)[axis]] * counts[face]
    normals = np.array(normals)
    faces = np.array(faces)
    offsets = np.where(faces % 2 == 1, SIZE[faces // 2], 0.0)
    return np.vstack(points), faces, normals, offsets


def surfaces(normals, offsets):
    return lambda p: ((p * normals).sum(axis=1) - offsets, normals)


def wish(faces, required=(0.0,) * 6, maximum=None, datum=None, balances=()):
    return Wish(
        groups=faces,
        required_mm=np.array(required, dtype=float)[faces],
        maximum_mm=None if maximum is None else np.array(maximum, dtype=float)[faces],
        datum_mm=None if datum is None else np.array(datum, dtype=float)[faces],
        datum_rank=faces,
        balances=balances,
    )


def solve(stock, thickness=0.0, given=None, **asked):
    points, faces, normals, offsets = blank(stock) if given is None else given
    placed = place_evenly(
        points,
        surfaces(normals, offsets),
        wish(faces, **asked),
        thickness_mm=thickness,
        rotation=TURN,
        translation_mm=SHIFT,
    )
    smallest = {f: placed.overstock_mm[faces == f].min() for f in np.unique(faces)}
    return placed, [smallest.get(f) for f in range(6)], faces


@pytest.mark.parametrize(
    ("stock", "expected"),
    [
        (ASYMMETRIC, [5, 5, 5, 5, 5, 5]),
        (((3, 7), (2, 1), (6, 4)), [5, 5, 1.5, 1.5, 5, 5]),
        (((2, 2), (2, 1), (6, 4)), [2, 2, 1.5, 1.5, 5, 5]),
    ],
)
def test_overstock_is_largest_group_by_group(stock, expected):
    placed, overstock, _ = solve(stock)
    assert overstock == pytest.approx(expected, abs=1e-6)
    assert np.abs(placed.rotation - np.eye(3)).max() < 1e-8  # no tilt


def test_too_little_material_is_named_with_its_faces():
    placed, _, faces = solve(((3, 7), (-1.5, -1), (6, 4)))
    assert placed.smallest_mm == pytest.approx(-1.25, abs=1e-6)
    assert set(faces[placed.limiting > 1e-6]) == {2, 3}


def test_multipliers_bound_the_margin_whatever_the_placement():
    placed, _, _ = solve(((3, 7), (-1.5, -1), (6, 4)))
    assert placed.limiting.sum() == pytest.approx(1.0)
    assert placed.limiting @ placed.margins_mm == pytest.approx(-1.25, abs=1e-6)
    assert np.abs(placed.limiting @ placed.jacobian).max() < 1e-6


def test_the_foil_is_taken_off():
    assert solve(ASYMMETRIC, thickness=0.1)[0].smallest_mm == pytest.approx(4.9, abs=1e-6)


def test_allowances_shift_the_middle():
    placed, overstock, _ = solve(ASYMMETRIC, required=[1, 6, 0, 0, 0, 0])
    assert placed.smallest_mm == pytest.approx(1.5, abs=1e-6)
    assert overstock[:2] == pytest.approx([2.5, 7.5], abs=1e-6)


def test_a_tilted_top_costs_only_what_it_must():
    points, faces, normals, offsets = blank(((5, 5),) * 3)
    corners = np.array([(x, y) for x in (0.0, 1000.0) for y in (0.0, 400.0)])
    extra = [np.c_[corners, np.full(4, -5.0)], np.c_[corners, 303 + 4 * corners[:, 0] / 1000]]
    for face, z in ((4, extra[0]), (5, extra[1])):
        points[np.flatnonzero(faces == face)[:4]] = z
    top = faces == 5
    points[top, 2] = 303 + 4 * points[top, 0] / 1000
    _, overstock, _ = solve(None, given=(points, faces, normals, offsets))
    assert overstock == pytest.approx([5, 5, 5, 5, 4, 4], abs=1e-6)


def test_what_no_face_stops_is_said_and_does_not_drift():
    given = blank(ASYMMETRIC, (0, 16, 16, 16, 16, 16))
    placed, overstock, _ = solve(None, given=given)
    assert len(placed.loose) == 1
    assert placed.loose[0] == pytest.approx([1, 0, 0, 0, 0, 0], abs=1e-6)
    assert overstock[2:] == pytest.approx([5, 5, 5, 5], abs=1e-6)
    assert abs(placed.translation_mm[0]) < 40.0


def test_a_motion_that_no_point_holds_is_told():
    given = blank(ASYMMETRIC, (0, 0, 16, 16, 16, 16))
    placed, _, _ = solve(None, given=given)
    assert len(placed.free) == 1
    assert abs(placed.free[0][0]) == pytest.approx(1.0)


def test_a_maximum_holds_and_the_rest_is_raised():
    placed, overstock, _ = solve(ASYMMETRIC, maximum=[np.inf, 4.0, *[np.inf] * 4])
    assert placed.smallest_mm == pytest.approx(4.0, abs=1e-6)
    assert overstock == pytest.approx([6, 4, 5, 5, 5, 5], abs=1e-6)
    assert placed.breach_mm == pytest.approx(0.0, abs=1e-6)


def test_limits_that_contradict_each_other_are_broken_as_little_as_can_be():
    placed, _, _ = solve(ASYMMETRIC, maximum=[4.0, 4.0, *[np.inf] * 4])
    assert placed.breach_mm == pytest.approx(1.0, abs=1e-6)


def test_a_datum_face_comes_out_at_its_stock():
    datum = [np.nan] * 4 + [1.5, np.nan]
    placed, overstock, faces = solve(ASYMMETRIC, datum=datum)
    assert placed.overstock_mm[faces == 4] == pytest.approx(1.5, abs=1e-6)
    assert overstock == pytest.approx([5, 5, 5, 5, 1.5, 8.5], abs=1e-6)


def test_datum_faces_locate_rank_by_rank():
    """Three, two and one point: the classical location, exact at all six."""
    points, faces, normals, offsets = blank(ASYMMETRIC, (1, 0, 2, 0, 3, 0))
    random = np.random.default_rng(4)
    points = points + random.normal(0.0, 0.5, points.shape)
    datum = [2.0, np.nan, 1.0, np.nan, 0.5, np.nan]
    placed, _, _ = solve(None, given=(points, faces, normals, offsets), datum=datum)
    assert placed.overstock_mm == pytest.approx(np.array(datum)[faces], abs=1e-6)


def test_a_tolerance_between_two_groups_holds():
    balance = Balance(first=0, second=1, low_mm=-1.0, high_mm=-0.5)
    _, overstock, _ = solve(ASYMMETRIC, balances=(balance,))
    assert overstock[:2] == pytest.approx([4.75, 5.25], abs=1e-6)


def test_faces_that_are_not_milled_give_no_margin():
    placed, overstock, _ = solve(ASYMMETRIC, required=[-np.inf, 0, 0, 0, 0, 0])
    assert overstock[2:] == pytest.approx([5, 5, 5, 5], abs=1e-6)
    assert len(placed.loose) == 1  # +x alone does not stop the part


@pytest.mark.parametrize("seed", range(3))
def test_rough_surfaces_come_out_as_an_independent_optimiser_says(seed):
    points, faces, normals, offsets = blank(ASYMMETRIC, seed=seed)
    random = np.random.default_rng(seed)
    points = points + normals * random.normal(0.0, 0.4, len(points))[:, None]
    placed, _, _ = solve(None, given=(points, faces, normals, offsets))

    def margins(x):
        turned = points @ Rotation.from_rotvec(x[3:6] * 1e-3).as_matrix().T + x[:3]
        return (turned * normals).sum(axis=1) - offsets

    best = minimize(
        lambda x: -x[6],
        np.append(np.zeros(6), margins(np.zeros(6)).min()),
        jac=lambda x: np.append(np.zeros(6), -1.0),
        constraints={"type": "ineq", "fun": lambda x: margins(x) - x[6]},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert placed.smallest_mm == pytest.approx(best.x[6], abs=1e-6)


def test_many_points_come_out_as_few_do():
    _, overstock, _ = solve(None, given=blank(ASYMMETRIC, (200,) * 6))
    assert overstock == pytest.approx([5] * 6, abs=1e-6)


def test_of_equal_placements_the_start_does_not_decide():
    points, faces, normals, offsets = blank(ASYMMETRIC)
    points = points + normals * np.random.default_rng(9).normal(0, 0.4, len(points))[:, None]
    poses = []
    for start in (np.zeros(3), SHIFT):
        placed = place_evenly(
            points, surfaces(normals, offsets), wish(faces), rotation=TURN, translation_mm=start
        )
        poses.append(points @ placed.rotation.T + placed.translation_mm)
    assert np.abs(poses[0] - poses[1]).max() < 1e-5


def test_least_squares_favours_the_face_with_many_points():
    points, faces, normals, offsets = blank(((5, 5),) * 3, (20, 3, 16, 16, 16, 16))
    rotation, translation = place_by_least_squares(points, surfaces(normals, offsets))
    placed = points @ rotation.T + translation
    distance, _ = surfaces(normals, offsets)(placed)
    assert distance[faces == 1].mean() > 8.0 > 2.0 > distance[faces == 0].mean()
