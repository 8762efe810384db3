"""Placements of a block in its blank against exact answers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omm_core.overstock.placement import place_by_least_squares, place_evenly

SIZE = np.array([1000.0, 400.0, 300.0])


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


def solve(stock, required=None, thickness=0.0):
    points, faces, normals, offsets = blank(stock)
    turn = Rotation.from_rotvec([0.015, -0.015, 0.017]).as_matrix()
    required = np.zeros(6) if required is None else np.array(required)
    placed = place_evenly(
        points,
        surfaces(normals, offsets),
        required_mm=required[faces],
        groups=faces,
        thickness_mm=thickness,
        rotation=turn,
        translation_mm=np.array([20.0, -21.0, 21.0]),
    )
    return placed, [placed.margins_mm[faces == f].min() for f in range(6)], faces


@pytest.mark.parametrize(
    ("stock", "expected"),
    [
        (((3, 7), (8, 2), (6, 4)), [5, 5, 5, 5, 5, 5]),
        (((3, 7), (2, 1), (6, 4)), [5, 5, 1.5, 1.5, 5, 5]),
        (((2, 2), (2, 1), (6, 4)), [2, 2, 1.5, 1.5, 5, 5]),
    ],
)
def test_overstock_is_largest_group_by_group(stock, expected):
    _, margins, _ = solve(stock)
    assert margins == pytest.approx(expected, abs=1e-6)


def test_too_little_material_is_named_with_its_faces():
    placed, _, faces = solve(((3, 7), (-1.5, -1), (6, 4)))
    assert placed.smallest_mm == pytest.approx(-1.25, abs=1e-6)
    assert set(faces[placed.limiting > 1e-6]) == {2, 3}


def test_the_foil_is_taken_off():
    assert solve(((3, 7), (8, 2), (6, 4)), thickness=0.1)[0].smallest_mm == pytest.approx(4.9)


def test_allowances_shift_the_middle():
    placed, margins, _ = solve(((3, 7), (8, 2), (6, 4)), required=[1, 6, 0, 0, 0, 0])
    assert placed.smallest_mm == pytest.approx(1.5, abs=1e-6)
    assert margins[:2] == pytest.approx([1.5, 1.5], abs=1e-6)


def test_least_squares_favours_the_face_with_many_points():
    points, faces, normals, offsets = blank(((5, 5),) * 3, (20, 3, 16, 16, 16, 16))
    rotation, translation = place_by_least_squares(points, surfaces(normals, offsets))
    placed = points @ rotation.T + translation
    distance, _ = surfaces(normals, offsets)(placed)
    assert distance[faces == 1].mean() > 8.0 > 2.0 > distance[faces == 0].mean()
