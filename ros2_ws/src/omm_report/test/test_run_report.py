"""A report carries the result it shows, and is the same each time."""

import hashlib
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pikepdf
import pytest
from whole_suite import shared_data

from omm_report.language import LANGUAGES, catalogue, text
from omm_report.run_report import run_report
from omm_runs.solving import SolvedRun, SolveRunOptions, solve_run

BENCH = shared_data("bench")


def _attached(report: bytes) -> Any:
    with pikepdf.open(io.BytesIO(report)) as pdf:
        return json.loads(pdf.attachments["result.json"].get_file().read_bytes())


@pytest.fixture(scope="module")
def solved() -> SolvedRun:
    return solve_run(BENCH)


@pytest.fixture(scope="module")
def reports(solved: SolvedRun) -> dict[str, bytes]:
    """Before and after (the same run twice), in each language."""
    return {language: run_report([solved, solved], language) for language in LANGUAGES}


def test_same_recordings_same_bytes(solved: SolvedRun, reports: dict[str, bytes]) -> None:
    assert run_report([solved, solved]) == reports["en"]


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


@pytest.mark.parametrize("language", ["en", "de", "es", "eu"])
def test_the_document_is_archival_in_every_language_with_the_same_data(
    reports: dict[str, bytes], language: str
) -> None:
    report = reports[language]
    assert _attached(report) == _attached(reports["en"])
    with pikepdf.open(io.BytesIO(report)) as pdf:
        assert str(pdf.Root.Lang) == language
        metadata = pdf.open_metadata()
        assert metadata.pdfa_status == "3B"
        assert metadata["dc:title"] == text("doc.title", language)
        assert not pdf.is_encrypted
        assert pdf.Root.OutputIntents[0].S == "/GTS_PDFA1"
        assert {str(file.AFRelationship) for file in pdf.Root.AF} <= {"/Data", "/Unspecified"}
        assert "/JavaScript" not in (pdf.Root.get("/Names") or {})
        fonts = [o for o in pdf.objects if isinstance(o, pikepdf.Dictionary)]
        assert all("/FontFile2" in o for o in fonts if o.get("/Type") == "/FontDescriptor")


def test_the_xml_holds_every_value_with_its_uncertainty(
    solved: SolvedRun, reports: dict[str, bytes]
) -> None:
    with pikepdf.open(io.BytesIO(reports["en"])) as pdf:
        root = ElementTree.fromstring(pdf.attachments["result.dcc.xml"].get_file().read_bytes())
    spaces = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
    values = [float(v.text or "") for v in root.findall(".//si:real/si:value", spaces)]
    U = [float(u.text or "") for u in root.findall(".//si:valueExpandedMU", spaces)]
    solution = solved.result.solution
    both = [*map(float, solution.own.theta), *map(float, solution.absolute.theta)]
    assert values == [*both, *both]
    assert U[:7] == [float(u) for u in solution.expanded_uncertainty]
    assert "not a calibration certificate" in ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize("language", ["de", "es", "eu"])
def test_no_english_is_left_in_the_document(reports: dict[str, bytes], language: str) -> None:
    import pypdfium2

    with pypdfium2.PdfDocument(reports[language]) as pdf:
        told = "".join(page.get_textpage().get_text_range() for page in pdf)
    english = {v for k, v in catalogue("en").items() if k.startswith("doc.") and "{" not in v}
    kept = {v for v in english if len(v) > 5 and re.search(rf"(?m)^{re.escape(v)}", told)}
    assert kept == set()
    assert re.search(r"-?\d+,\d{4}", told)
    assert not re.search(r"(?m)^(α|x)\s+-?\d+\.\d{4}", told)
