"""Budgets, campaigns and probing checks as documents: whole, readable, the same each time."""

import json

import numpy as np
import pikepdf
import pytest
from pypdfium2 import PdfDocument

from omm_core.budget.box_map import BoxMap
from omm_core.budget.budget import evaluate
from omm_core.budget.budget_file import NamedPoint
from omm_core.budget.campaign import MeasuredRun, evaluate_campaign
from omm_core.budget.evaluation import Contribution, standard
from omm_core.budget.probing import check_probing
from omm_core.files.probed import ProbedPoint
from omm_report.budget_report import budget_document, campaign_document, probing_document


def budget_pdf() -> bytes:
    points = [
        NamedPoint(name="near", xyz_mm=np.zeros(3)),
        NamedPoint(name="far", xyz_mm=np.ones(3)),
    ]
    contributions = [
        Contribution(
            name=name, group=group, millimetres=np.full((2, 3), u) * [[1], [2]],
            shape=standard(kind),
        )
        for name, group, u, kind in (
            ("u_ip", "u_ip", 0.01, "normal"), ("fixture", "other", 0.02, "uniform")
        )
    ]  # fmt: skip
    budget = evaluate(points, contributions, tolerance_mm=0.3)
    line = np.linspace(0, 1000, 3)
    box_map = BoxMap(axes_mm=(line, line, np.zeros(1)), expanded_mm=np.ones((3, 3, 1, 3)))
    return budget_document(budget, box_map, (), "budget.yaml")


def campaign_pdf() -> bytes:
    random = np.random.default_rng(1)
    cov = np.eye(7) * 1e-6
    measured = [
        MeasuredRun(clamping=k, repeat=n, theta=random.normal(size=7) * 1e-3, covariance=cov)
        for k in range(3)
        for n in range(2)
    ]
    return campaign_document(evaluate_campaign(measured), "campaign.yaml")


def probing_pdf() -> bytes:
    points = [
        ProbedPoint(name=f"P{i}", part_mm=np.eye(3)[i % 3] * 100, machine_mm=np.eye(3)[i % 3] * 100,
                    sigma_mm=0.01)
        for i in range(4)
    ]  # fmt: skip
    check = check_probing(points, [0.0] * 6, np.eye(6) * 1e-8)
    return probing_document(check, "run.mcap")


DOCUMENTS = {
    "budget.json": (budget_pdf, ("Uncertainty budget", "far (worst)", "fixture", "not capable")),
    "campaign.json": (campaign_pdf, ("7D, table 3", "3 clampings, 2 repeats", "Analysis")),
    "probing.json": (probing_pdf, ("100.0% of 12 coordinates inside U", "run.mcap")),
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_says_it_carries_it_and_is_the_same_each_time(name, tmp_path) -> None:  # type: ignore[no-untyped-def]
    make, words = DOCUMENTS[name]
    content = make()
    assert content == make()
    path = tmp_path / "out.pdf"
    path.write_bytes(content)
    with PdfDocument(path) as document:
        text = " ".join(
            " ".join(page.get_textpage().get_text_bounded().split()) for page in document
        )
    for each in words:
        assert each in text
    with pikepdf.open(path) as pdf:
        attached = json.loads(pdf.attachments[name].get_file().read_bytes())
    assert attached
