"""A report carries the result it shows, and is the same each time."""

import hashlib
import io
import json
from pathlib import Path

import pikepdf
import pytest

from omm_report.run_report import run_report
from omm_runs.solving import SolvedRun, solve_run

BENCH = Path(__file__).parents[4] / ".." / "shared" / "data" / "bench"


@pytest.fixture(scope="module")
def solved() -> SolvedRun:
    if not (BENCH / "run.mcap").is_file():
        pytest.skip("the shared bench recording is not here")
    return solve_run(BENCH)


def test_same_recordings_same_bytes(solved: SolvedRun) -> None:
    assert run_report([solved, solved]) == run_report([solved, solved])


def test_attached_data_is_the_result_with_checksums(solved: SolvedRun) -> None:
    with pikepdf.open(io.BytesIO(run_report([solved]))) as pdf:
        data = json.loads(pdf.attachments["result.json"].get_file().read_bytes())
    assert data[0]["result"] == json.loads(json.dumps(solved.result.to_json_dict()))
    expected = hashlib.sha256((BENCH / "part.yaml").read_bytes()).hexdigest()
    assert data[0]["files"]["part.yaml"] == expected
    assert data[0]["seals"][0]["file"] == "run.mcap"
