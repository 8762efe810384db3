"""Fits of recorded castings: as much stock as there is, and a refusal where there is none."""

import json

import pytest
import yaml
from whole_suite import shared_data

from omm_bringup.command_line import main

DATA = shared_data("fit")


def fit(case, folder):
    """Fit with the STL, which needs no optional reader; return status and JSON."""
    given = yaml.safe_load((DATA / case / "fit.yaml").read_text())
    given |= {"cad": str(DATA / case / "part.stl"), "points": str(DATA / case / "points.json")}
    (folder / "fit.yaml").write_text(yaml.safe_dump(given))
    out = folder / "fit.json"
    status = main(["fit", str(folder), "--json", str(out), "--out", str(folder / "part.yaml")])
    return status, json.loads(out.read_text())


def test_a_casting_gets_the_largest_smallest_margin(tmp_path):
    status, result = fit("casting", tmp_path)
    assert status == 0
    assert result["minimum_margin_mm"] == pytest.approx(3.1244, abs=0.003)
    targets = yaml.safe_load((tmp_path / "part.yaml").read_text())["targets"]
    assert {t["id"] for t in targets} == {102, 5, 133, 69}


def test_a_casting_that_is_short_is_refused_with_its_faces(tmp_path):
    status, result = fit("short", tmp_path)
    assert status == 1
    assert result["feasible"] is False
    assert all(name.startswith(("plane (-1 0 0)", "plane (1 0 0)")) for name in result["limiting"])
    assert len(result["limiting"]) == 2
    assert not (tmp_path / "part.yaml").exists()
