"""A budget.yaml comes to the paper's tables, to closed forms and to what the run says."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_runs.budgeting import budget_of

PART = """
part: {name: block}
target_family: aicon12
targets:
  - {id: 1, xyz_mm: [0, 0, 0], dot_diameter_mm: 5}
  - {id: 2, xyz_mm: [1500, 0, 0], dot_diameter_mm: 5}
  - {id: 3, xyz_mm: [1500, 1000, 0], dot_diameter_mm: 5}
  - {id: 4, xyz_mm: [0, 1000, 0], dot_diameter_mm: 5}
box_mm: [[0, 0, 0], [1500, 1000, 500]]
"""
BENCH = """
part: part.yaml
points: box
u_ip: {sigma_mm: [0.0201, 0.0274, 0.0235]}
u_it: {expansion_per_K: 11.0e-6, temperature_K: {half_width: 1, distribution: uniform}}
u_out: {sigma_mm: [0.0709, 0.0705, 0.0703]}
tolerance_mm: 2.0
"""
# u_it as printed: 6.4 µm per metre, rounded before it was multiplied.
INDUSTRIAL = """
part: part.yaml
points: [{name: end, xyz_mm: [10000, 3000, 5000]}]
u_ip: {sigma_mm: [0.0576, 0.1402, 0.1349]}
u_it: {sigma_mm: [0.0640, 0.0192, 0.0320]}
u_out: {sigma_mm: [0.1443, 0.0893, 0.1124]}
tolerance_mm: 2.0
"""


@pytest.fixture
def budget(tmp_path: Path):  # type: ignore[no-untyped-def]
    def evaluated(text: str, part: str = PART, **files: str):  # type: ignore[no-untyped-def]
        (tmp_path / "part.yaml").write_text(part)
        for name, content in files.items():
            (tmp_path / f"{name}.json").write_text(content)
        (tmp_path / "budget.yaml").write_text(text)
        return budget_of(tmp_path)

    return evaluated


def microns(values, digits: int = 1) -> list[float]:  # type: ignore[no-untyped-def]
    return [round(1e3 * float(v), digits) for v in values]


def test_the_papers_tables_4_and_5_at_the_bench(budget) -> None:  # type: ignore[no-untyped-def]
    result = budget(BENCH)
    points = result.to_json_dict()["points"]
    far = next(p for p in points if p["xyz_mm"] == [1500.0, 1000.0, 500.0])
    assert microns(far["u_it_mm"]) == [9.5, 6.4, 3.2]
    assert microns(far["U_omm_mm"]) == [44.5, 56.3, 47.4]
    # The paper prints 148.5 for X; its own contributors make 148.6.
    assert microns(far["U_total_mm"]) == [148.6, 151.8, 148.4]
    assert result.points[result.worst[0]].xyz_mm[1] == 1000.0


def test_the_papers_table_6_and_its_capability(budget) -> None:  # type: ignore[no-untyped-def]
    document = budget(INDUSTRIAL).to_json_dict()
    # Printed: 336.1, 334.6, 356.9; the last two are cut off, not rounded.
    assert microns(document["points"][0]["U_total_mm"], 2) == [336.07, 334.66, 356.96]
    assert [round(100 * v, 1) for v in document["capability"]["U_over_T"]] == [16.8, 16.7, 17.8]
    assert document["capability"]["verdict"] == "capable"


def test_a_length_error_counts_by_distance_and_is_rectangular(budget) -> None:  # type: ignore[no-untyped-def]
    text = """
part: part.yaml
points: [{name: X, xyz_mm: [10000, 0, 0]}, {name: diagonal, xyz_mm: [300, 400, 1200]}]
u_out: {constant_mm: 0.05, per_metre_mm: 0.02}
"""
    points = budget(text).to_json_dict()["points"]
    assert microns(points[0]["u_out_mm"], 2) == [144.34] * 3
    assert points[1]["u_out_mm"] == pytest.approx([(0.05 + 0.02 * 1.3) / math.sqrt(3)] * 3)
    # 95.45 % of a rectangle of half width LME, by the interval with equal tails; GUM says 2 u.
    assert points[0]["monte_carlo"]["U_mm"] == pytest.approx([0.25 * 0.9545] * 3, rel=0.001)
    assert points[0]["monte_carlo"]["agrees"] is False
    assert points[0]["U_total_mm"] == pytest.approx([0.5 / math.sqrt(3)] * 3)


def test_own_contributors_correlate_and_have_degrees_of_freedom(budget) -> None:  # type: ignore[no-untyped-def]
    text = """
part: part.yaml
points: [{name: P, xyz_mm: [0, 0, 0]}]
contributors:
  - {name: a, unit: um, distribution: normal, standard_uncertainty: 3, sensitivity: [2, 0, 1],
     correlation: {b: -0.5}}
  - {name: b, unit: mm, distribution: normal, standard_uncertainty: 0.004, sensitivity: [1, 1, 0]}
  - {name: c, unit: K, distribution: uniform, half_width: 2, sensitivity: [0, 0.003, 0],
     degrees_of_freedom: 4}
coverage_probability: 0.95
"""
    result = budget(text)
    u = result.combined.standard_uncertainty_mm[0]
    # GUM eq. 13: 6² + 4² − 2 · ½ · 6 · 4 = 28 µm².
    c = 6.0 / math.sqrt(3.0)
    assert 1e6 * u**2 == pytest.approx([28.0, 16.0 + c**2, 9.0])
    freedom = (16.0 + c**2) ** 2 / (c**4 / 4)
    assert result.combined.degrees_of_freedom[0] == pytest.approx([np.inf, freedom, np.inf])
    from scipy import stats

    assert result.expanded_mm[0, 1] == pytest.approx(stats.t.ppf(0.975, freedom) * u[1])
    assert sum(result.shares().values()) == pytest.approx(1.0)


def test_the_part_expands_along_its_own_axes_however_it_lies(budget) -> None:  # type: ignore[no-untyped-def]
    turned = (
        PART + "nominal: {translation_mm: [0, 0, 0], euler_xyz_rad: [1.5707963267948966, 0, 0]}"
    )
    text = """
part: part.yaml
points: [{name: P, xyz_mm: [1000, 500, 0]}]
u_it: {expansion_per_K: 11.0e-6, temperature_K: {half_width: 1, distribution: uniform}}
"""
    points = budget(text, turned).to_json_dict()["points"]
    assert points[0]["u_it_mm"] == pytest.approx([0.011 / math.sqrt(3), 0, 0.0055 / math.sqrt(3)])


def test_the_surveys_covariance_comes_turned_into_the_machine(budget) -> None:  # type: ignore[no-untyped-def]
    # The survey's frame is the part's, turned by 90° about z and shifted.
    places = {1: (0, 0), 2: (1500, 0), 3: (1500, 1000), 4: (0, 1000)}
    points = [
        {"name": str(k), "coded": True, "id": k, "xyz_mm": [-y + 7, x - 3, 5],
         "sigma_xyz_mm": [0.01 * k, 0.02 * k, 0.03 * k]}
        for k, (x, y) in places.items()
    ]  # fmt: skip
    survey = {"target_family": "aicon12", "coded_dot_diameter_mm": 5, "points": points}
    text = """
part: part.yaml
points: [{name: "3", xyz_mm: [1500, 1000, 0]}, {name: near 2, xyz_mm: [1400, 10, 0]}]
u_out: {points: survey.json}
"""
    result = budget(text, survey=json.dumps(survey))
    found = result.to_json_dict()["points"]
    assert found[0]["u_out_mm"] == pytest.approx([0.06, 0.03, 0.09])
    assert found[1]["u_out_mm"] == pytest.approx([0.04, 0.02, 0.06])
    assert any("nearest" in words for words in result.findings)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("part: part.yaml", "at least one of"),
        (BENCH + "coverage_factor: 2\ncoverage_probability: 0.95", "got both"),
        (BENCH + "contributors: [{name: a, distribution: odd, half_width: 1}]", "distribution"),
        (BENCH + "contributors: [{name: a, unit: K, sigma: 1}]", "sensitivity"),
        (BENCH + "contributors: [{name: a, sigma: 1, correlation: {b: 0.1}}]", "correlation"),
        (BENCH + "contributors: [{name: u_ip, sigma: 1}]", "taken"),
        (BENCH.replace("[0.0201", "[-0.0201"), ">= 0"),
        (BENCH.replace("points: box", "points: [{name: a, xyz_mm: [0, 0]}]"), "3 numbers"),
        (BENCH.replace("points: box", "points: around"), "'box' or a list"),
    ],
)
def test_a_budget_that_cannot_be_meant_is_refused(budget, text: str, told: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=told):
        budget(text)
