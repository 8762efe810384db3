"""The full covariance beside points.json: by name, in any order, checked."""

import json

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.points import load_points

NAMES = ["a", "b", "c"]


def written(folder, covariance, order=("c", "a"), key=None):
    points = [
        {"name": n, "coded": False, "xyz_mm": [0, 0, 0], "sigma_xyz_mm": [0.1, 0.2, 0.3]}
        for n in NAMES
    ]
    told = {"file": "full.npy", "order": list(order)} if key is None else key
    content = {
        "target_family": "aicon12",
        "coded_dot_diameter_mm": 8.0,
        "points": points,
        "full_covariance": told,
    }
    (folder / "points.json").write_text(json.dumps(content))
    if covariance is not None:
        np.save(folder / "full.npy", covariance)
    return folder / "points.json"


def covariance(size=6):
    root = np.random.default_rng(0).normal(size=(size, size))
    return root @ root.T


def test_rows_are_found_by_name(tmp_path):
    given = covariance()
    survey = load_points(written(tmp_path, given))
    assert survey.covariance([2, 0]) == pytest.approx(given)  # the file's order: c, a
    assert survey.covariance([0]) == pytest.approx(given[3:, 3:])


def test_a_point_that_is_not_in_it_keeps_its_own(tmp_path):
    survey = load_points(written(tmp_path, covariance()))
    assert survey.covariance([1]) == pytest.approx(np.diag([0.01, 0.04, 0.09]))
    assert survey.covariance([0, 1])[:3, 3:] == pytest.approx(np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "cannot be read"),
        (covariance(9), "expected"),
        (np.triu(np.ones((6, 6))), "symmetric"),
        (-np.eye(6), "negative"),
        (np.full((6, 6), np.nan), "finite"),
    ],
)
def test_what_is_no_covariance_is_refused(tmp_path, given, words):
    with pytest.raises(InputError, match=words):
        load_points(written(tmp_path, given))


def test_a_key_without_order_is_refused(tmp_path):
    with pytest.raises(InputError, match="'file' and 'order'"):
        load_points(written(tmp_path, covariance(), key={"file": "full.npy"}))
