"""Lengths from a CSV: errors, their sigma and the limit, calculated anew from what is delivered."""

import json

import numpy as np
import pytest
from drawn_photographs import NUMBERS, bar_mm, photograph
from PIL import Image

from omm_core.errors import InputError
from omm_runs.survey_acceptance import add_acceptance, read_lengths
from omm_runs.survey_result import write_points
from omm_runs.surveying import survey

# Over the plate: (1, 13) is the longest; its calibrated length is told 0.5 mm too long.
WRONG_MM = 0.5
PAIRS = [(1, 13), (1, 4), (5, 9), (2, 12), (13, 10)]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    for i in range(6):
        Image.fromarray(photograph(i)).save(folder / f"p{i}.png")
    (folder / "survey.yaml").write_text(
        "photos: '*.png'\ntarget_family: aicon12\n"
        "camera: {pixel_size_mm: 0.01, focal_length_mm: 10}\nscale_bars:\n"
        f"- {{ends: [1, 4], length_mm: {bar_mm(1, 4):.5f}, sigma_mm: 0.005}}\n"
        f"- {{ends: [1, 10], length_mm: {bar_mm(1, 10):.5f}, sigma_mm: 0.005}}\n"
    )
    return survey(folder)


def lengths_file(folder, wrong_mm):
    path = folder / "lengths.csv"
    rows = [f"{a}, {b}, {bar_mm(a, b) + wrong_mm * ((a, b) == PAIRS[0]):.6f}" for a, b in PAIRS]
    path.write_text("\n".join(["first, second, length_mm", *rows]) + "\n")
    return path


def measured_anew(folder, found):
    """Return lengths and their sigmas out of points.json and the covariance beside it."""
    write_points(folder / "points.json", found)
    written = json.loads((folder / "points.json").read_text())
    xyz = np.array([p["xyz_mm"] for p in written["points"]])
    full = np.load(folder / written["full_covariance"]["file"])
    at = {p["id"]: row for row, p in enumerate(written["points"]) if p.get("id")}
    random = np.random.default_rng(4)
    drawn = random.multivariate_normal(xyz.ravel(), full, 20000, method="eigh").reshape(
        -1, len(xyz), 3
    )
    sets = np.concatenate([xyz[None], drawn])
    apart = [np.linalg.norm(sets[:, at[a]] - sets[:, at[b]], axis=1) for a, b in PAIRS]
    return [length[0] for length in apart], [length[1:].std() for length in apart]


def test_errors_sigmas_and_limits_are_those_of_the_delivered_coordinates(found, tmp_path):
    assert set(NUMBERS) == set(found.delivered.numbers)
    passed = add_acceptance(found, read_lengths(lengths_file(tmp_path, 0.0)), (0.04, 0.1))
    told = found.json["acceptance"]
    assert passed
    assert told["passed"]
    lengths, sigmas = measured_anew(tmp_path, found)
    true = np.array([round(bar_mm(a, b), 6) for a, b in PAIRS])
    assert [tuple(e["ends"]) for e in told["lengths"]] == PAIRS
    assert [e["measured_mm"] for e in told["lengths"]] == pytest.approx(lengths, abs=1e-9)
    assert [e["error_mm"] for e in told["lengths"]] == pytest.approx(lengths - true, abs=1e-9)
    assert [e["sigma_mm"] for e in told["lengths"]] == pytest.approx(sigmas, rel=0.03)
    assert [e["limit_mm"] for e in told["lengths"]] == pytest.approx(0.04 + 0.1 * true / 1e3)
    errors = np.array(lengths) - true
    assert told["rms_error_mm"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-6)
    assert np.abs(errors / sigmas).max() < 4.0
    # LME of the longest, as a rectangular distribution of that half width.
    u_out = (0.04 + 0.1 * true.max() / 1e3) / np.sqrt(3.0)
    assert told["u_out_mm"] == pytest.approx(u_out)
    assert any(f"u_out = LME / sqrt(3) = {u_out:.4f} mm" in w for w in found.json["findings"])


def test_a_length_beyond_its_limit_fails_and_is_named(found, tmp_path):
    assert not add_acceptance(found, read_lengths(lengths_file(tmp_path, WRONG_MM)), (0.05, 0.02))
    told = found.json["acceptance"]
    assert [e["within"] for e in told["lengths"]] == [False, True, True, True, True]
    assert told["largest_error_mm"] == pytest.approx(-WRONG_MM, abs=0.02)
    assert any("do NOT keep to" in w and "at 1-13" in w for w in found.json["findings"])


@pytest.mark.parametrize("limit", [(-0.05, 0.02), (np.nan, 0.02), (0.05, np.inf), (0.0, 0.0)])
def test_a_limit_that_is_none_is_refused(found, tmp_path, limit):
    with pytest.raises(InputError, match="--limit"):
        add_acceptance(found, read_lengths(lengths_file(tmp_path, 0.0)), limit)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("1,1,100", "two different ends"),
        ("1,2,-5", "above 0"),
        ("1,2,nan", "number for length_mm"),
        ("1,2", "number for length_mm"),
        ("1.5,2,100", "numbers of coded targets"),
        ("", "a line for each length"),
        ("1,2,100\n2,1,100.5", "line 3: expected each length once; 2-1 is that of .*line 2"),
    ],
)
def test_rows_that_are_no_length_are_refused(tmp_path, row, words):
    (tmp_path / "lengths.csv").write_text(f"first,second,length_mm\n{row}\n")
    with pytest.raises(InputError, match=words):
        read_lengths(tmp_path / "lengths.csv")
