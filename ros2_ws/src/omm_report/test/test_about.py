"""report.yaml: who measured what for whom stands in the document and in the attached XML."""

import io
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pikepdf
import pytest
from whole_suite import shared_data

from omm_core.errors import InputError
from omm_report.about import About, about_of, load_about
from omm_report.run_report import run_report
from omm_runs.budgeting import budget_from, load_sources
from omm_runs.solving import SolvedRun, solve_run

BENCH = shared_data("bench")
FULL = """
number: 2026-0042
order: A-17
place: Hall 3, machine 7
laboratory: {name: Präzision & <Söhne>, street: Werkstr. 1, post_code: "01234", city: Ulm,
             country: DE, email: mess@example.org, phone: "+49 1"}
customer: {name: Guss AG, city: Bern, country: CH}
responsible: [{name: A. Muster, role: metrologist}, {name: B. Beispiel}]
part: {name: bed 12, serial_number: S-0012, manufacturer: Guss AG}
equipment: [{name: camera, manufacturer: M, model: X1, serial_number: "2244", certificate: C-7}]
remark: after milling
budget: budget.yaml
"""
SPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture(scope="module")
def solved() -> SolvedRun:
    return solve_run(BENCH)


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "report.yaml"
        path.write_text(text)
        return path

    return write


def _xml(report: bytes) -> ElementTree.Element:
    with pikepdf.open(io.BytesIO(report)) as pdf:
        return ElementTree.fromstring(pdf.attachments["result.dcc.xml"].get_file().read_bytes())


def _words(report: bytes) -> str:
    import pypdfium2

    with pypdfium2.PdfDocument(report) as pdf:
        return "\n".join(page.get_textpage().get_text_range() for page in pdf)


def test_all_that_the_file_tells_is_on_paper_and_in_the_xml(
    solved: SolvedRun, written: Callable[[str], Path]
) -> None:
    about = load_about(written(FULL))
    report = run_report([solved], about=about)
    assert run_report([solved], about=about) == report
    words, root = _words(report), _xml(report)
    told = "".join(root.itertext())
    for text in (
        "2026-0042", "A-17", "Hall 3, machine 7", "Präzision & <Söhne>", "Werkstr. 1", "01234",
        "mess@example.org", "Guss AG", "A. Muster", "B. Beispiel", "S-0012", "X1", "2244", "C-7",
    ):  # fmt: skip
        assert text in words
        assert text in told
    assert "after milling" in words
    core = "dcc:administrativeData/dcc:coreData/"
    assert root.findtext(f"{core}dcc:countryCodeISO3166_1", namespaces=SPACES) == "DE"
    assert root.findtext(f"{core}dcc:uniqueIdentifier", namespaces=SPACES) == "2026-0042"
    signers = [e.text for e in root.iterfind(".//dcc:mainSigner", SPACES)]
    assert signers == ["true", "false"]
    assert "Not stated" not in told


def test_without_a_file_the_xml_names_what_the_schema_wants(solved: SolvedRun) -> None:
    told = "".join(_xml(run_report([solved])).itertext())
    missing = re.search(r"Not stated: ([^.]*)\.", told)
    assert missing is not None
    assert {"laboratory", "customer", "place"} <= set(missing[1].split(", "))


def test_the_administrative_part_has_the_order_of_the_schema(
    solved: SolvedRun, written: Callable[[str], Path]
) -> None:
    root = _xml(run_report([solved], about=load_about(written(FULL))))
    names = [e.tag.partition("}")[2] for e in root.find("dcc:administrativeData", SPACES) or ()]
    assert names == [
        "dccSoftware", "coreData", "items", "calibrationLaboratory", "respPersons", "customer",
        "statements",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "match"),
    [("laborotory: {name: x}", "laboratory"), ("laboratory: {city: x}", "name"),
     ("laboratory: {name: x, country: Germany}", "two capital letters"),
     ("number: [1]", "number"), ("number: 'a\\u0007'", "one line"),
     ("order: 'a\n\n  b'", "one line"), ("place: " + "x" * 300, "one line"),
     ("responsible: {name: x}", "responsible"), ("equipment: 3", "equipment")],
)  # fmt: skip
def test_what_is_wrong_in_the_file_is_told(
    written: Callable[[str], Path], text: str, match: str
) -> None:
    with pytest.raises(InputError, match=match):
        load_about(written(text.replace("'a\\u0007'", '"a\\u0007"')))


def test_the_file_beside_the_run_is_taken_where_none_is_named(
    written: Callable[[str], Path], tmp_path: Path
) -> None:
    path = written("number: beside")
    assert about_of(tmp_path).number == "beside"
    assert about_of(tmp_path / "run.mcap").number == "beside"
    named = tmp_path / "other.yaml"
    named.write_text("number: named")
    assert about_of(tmp_path, named).number == "named"
    path.unlink()
    assert about_of(tmp_path) == About()


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_budgets_summary_is_in_the_report(
    solved: SolvedRun, tmp_path: Path, language: str
) -> None:
    path = tmp_path / "budget.yaml"
    path.write_text(
        f"part: {BENCH}/part.yaml\nu_ip: {{sigma_mm: [0.01, 0.02, 0.03]}}\n"
        "u_out: {constant_mm: 0.05}\ntolerance_mm: 0.5\n"
    )
    budget = budget_from(load_sources(path))
    words = _words(run_report([solved], language, budget=budget))
    worst = f"{budget.expanded_mm.max():.4f}"
    assert (worst if language == "en" else worst.replace(".", ",")) in words
    assert ("corner x" in words) is (language == "en")
    assert "u_out" in words
