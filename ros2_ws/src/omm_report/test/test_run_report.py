"""A report carries the result it shows, and is the same each time."""

import hashlib
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pikepdf
import pytest
from whole_suite import shared_data

from omm_report.run_report import run_report
from omm_runs.solving import SolvedRun, SolveRunOptions, solve_run

BENCH = shared_data("bench")


def _attached(report: bytes) -> Any:
    with pikepdf.open(io.BytesIO(report)) as pdf:
        return json.loads(pdf.attachments["result.json"].get_file().read_bytes())


@pytest.fixture(scope="module")
def solved() -> SolvedRun:
    return solve_run(BENCH)


def test_same_recordings_same_bytes(solved: SolvedRun) -> None:
    assert run_report([solved, solved]) == run_report([solved, solved])


def test_attached_data_is_the_result_with_checksums(solved: SolvedRun) -> None:
    data = _attached(run_report([solved]))
    assert data[0]["result"] == json.loads(json.dumps(solved.result.to_json_dict()))
    expected = hashlib.sha256((BENCH / "part.yaml").read_bytes()).hexdigest()
    assert data[0]["files"]["part.yaml"] == expected
    assert data[0]["seals"][0]["file"] == "run.mcap"


def test_tolerances_of_the_part_file_are_decided(solved: SolvedRun, tmp_path: Path) -> None:
    alpha, z = solved.result.solution.theta[0], solved.result.solution.theta[5]
    part = tmp_path / "part.yaml"
    part.write_text(
        (BENCH / "part.yaml").read_text()
        + f"\nnominal: {{translation_mm: [null, 0, {z:.4f}],"
        + f" euler_xyz_rad: [{alpha - 1.0:.9f}, 0, 0]}}\n"
        + "tolerances: {alpha_rad: 0.5, x_mm: 1.0, z_mm: 1.0}\n"
    )
    decided = _attached(run_report([replace(solved, options=SolveRunOptions(part_file=part))]))
    assert [(d["quantity"], d["state"]) for d in decided[0]["decisions"]] == [
        ("α (mm/m)", "outside"),
        ("z (mm)", "inside"),
    ]
    assert decided[0]["decisions"][1]["advice"] == "good enough"
    assert _attached(run_report([solved]))[0]["decisions"] == []
