"""A budget.yaml comes to the paper's tables, to closed forms and to what the run says."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from omm_core.budget.campaign import MeasuredRun, evaluate_campaign, point_studies
from omm_core.budget.machine import geometry_left_mm
from omm_core.errors import InputError
from omm_runs import budgeting
from omm_runs.budgeting import budget_from, budget_of, load_sources, map_of
from omm_runs.what_if import what_ifs

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
    assert result.expanded_mm[0, 1] == pytest.approx(stats.t.ppf(0.975, freedom) * u[1])
    assert sum(result.shares().values()) == pytest.approx(1.0)


def test_a_contributor_may_go_with_u_it_and_what_is_not_there_is_told(budget) -> None:  # type: ignore[no-untyped-def]
    text = """
part: part.yaml
points: [{name: P, xyz_mm: [1000, 0, 0]}]
u_it: {expansion_per_K: 11.0e-6, temperature_K: {half_width: 1, distribution: uniform}}
contributors:
  - {name: a, standard_uncertainty: 0.01, sensitivity: [1, 0, 0], correlation: {u_it: 0.5, b: 0.3}}
"""
    result = budget(text)
    u_it = 0.011 / math.sqrt(3)
    expected = math.sqrt(u_it**2 + 0.01**2 + 2 * 0.5 * u_it * 0.01)
    assert result.combined.standard_uncertainty_mm[0, 0] == pytest.approx(expected)
    assert any("b, of which there is no contributor" in words for words in result.findings)


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


def test_a_measured_deviation_is_decided_upon_as_iso_14253_1_wants(budget) -> None:  # type: ignore[no-untyped-def]
    # u = 0.1, T/2 = 1: proven within 1 - 1.645 u and beyond 1 + 1.645 u.
    text = """
part: part.yaml
points:
  - {name: P, xyz_mm: [0, 0, 0], deviation_mm: [0.835, -0.836, 1.0]}
  - {name: Q, xyz_mm: [0, 0, 0], deviation_mm: [1.164, -1.165, 0]}
u_ip: {sigma_mm: [0.1, 0.1, 0.1]}
"""
    result = budget(text + "tolerance_mm: 2.0")
    first, second = (p["iso_14253_1"] for p in result.to_json_dict()["points"])
    assert first["decision"] == ["conforms", "not proven", "not proven"]
    assert second["decision"] == ["not proven", "does not conform", "conforms"]
    assert first["conformity_probability"][2] == pytest.approx(0.5)
    undecided = budget(text)
    assert "iso_14253_1" not in undecided.to_json_dict()["points"][0]
    assert any("no tolerance_mm" in words for words in undecided.findings)


def test_what_cancels_is_nothing_and_a_wrong_unit_is_doubted(budget) -> None:  # type: ignore[no-untyped-def]
    result = budget("""
part: part.yaml
contributors: [{name: a, sigma: 0.02, correlation: {b: -1}}, {name: b, sigma: 0.02}]
""")
    assert result.expanded_mm.max() == 0.0
    assert result.sampled.agrees.all()
    assert any("which no measurement has" in words for words in result.findings)
    microns_as_mm = budget("part: part.yaml\nu_ip: {sigma_mm: [20, 27, 24]}")
    assert any("all units are right" in words for words in microns_as_mm.findings)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("part: part.yaml", "at least one of"),
        (BENCH + "coverage_factor: 2\ncoverage_probability: 0.95", "got both"),
        (BENCH + "contributors: [{name: a, distribution: odd, half_width: 1}]", "distribution"),
        (BENCH + "contributors: [{name: a, unit: K, sigma: 1}]", "sensitivity"),
        (BENCH + "contributors: [{name: a, sigma: 1, correlation: {b: 1.1}}]", "correlation"),
        (BENCH + "contributors: [{name: a, sigma: 1, correlation: {a: 0.1}}]", "correlation"),
        (BENCH + "contributors: [{name: u_ip, sigma: 1}]", "taken"),
        (BENCH.replace("[0.0201", "[-0.0201"), ">= 0"),
        (BENCH.replace("11.0e-6", "11"), "11.0e-6"),
        (BENCH.replace(", temperature_K: {half_width: 1, distribution: uniform}", ""), "unsure"),
        (BENCH + "contributors: [{name: a, sigma: 1, half_width: 1}]", "got both"),
        (BENCH + "contributors: [{name: a, half_width: -1, distribution: uniform}]", "0 or more"),
        (BENCH + "contributors: [{name: a, sigma: 1, degrees_of_freedom: -3}]", "above 0"),
        (
            BENCH + "contributors: [{name: a, sigma: 1, correlation: {b: 0.9, c: 0.9}},"
            " {name: b, sigma: 1, correlation: {c: -0.9}}, {name: c, sigma: 1}]",
            "true together",
        ),
        (BENCH.replace("points: box", "points: [{name: a, xyz_mm: [0, 0]}]"), "3 numbers"),
        (BENCH.replace("points: box", "points: around"), "'box' or a list"),
    ],
)
def test_a_budget_that_cannot_be_meant_is_refused(budget, text: str, told: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=told):
        budget(text)


def write(folder: Path, text: str) -> Path:
    (folder / "budget.yaml").write_text(text)
    return folder


def test_u_ip_of_a_run_is_its_covariance_at_the_point(bench: Path, tmp_path: Path) -> None:
    text = f"""
part: {bench}/part.yaml
points: [{{name: P, xyz_mm: [700, 300, 200]}}]
u_ip: {{run: {bench}}}
"""
    sources = load_sources(write(tmp_path, text))
    found = budget_from(sources).to_json_dict()["points"][0]["u_ip_mm"]
    assert sources.run is not None
    solution = sources.run.result.solution
    random = np.random.default_rng(1)
    thetas = random.multivariate_normal(solution.theta[:6], solution.covariance[:6, :6], 20_000)
    # Lower case: about fixed axes, as (α, β, γ) everywhere here.
    at = Rotation.from_euler("xyz", thetas[:, :3]).apply([700, 300, 200]) + thetas[:, 3:]
    assert found == pytest.approx(np.std(at, axis=0), rel=0.03)


def test_u_ip_of_a_campaign_has_the_degrees_of_freedom_that_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    sigma = np.array([4e-6, 3e-6, 1e-6, 0.002, 0.003, 0.006, 1e-5])
    measured = [
        MeasuredRun(
            clamping=k,
            repeat=n,
            theta=np.array([0.0, 0, 0, 10, 20, 30, 0]) + random.normal(size=7) * sigma,
            covariance=np.diag(sigma**2),
        )
        for k in range(5)
        for n in range(3)
    ]
    (tmp_path / "part.yaml").write_text(PART)
    monkeypatch.setattr(budgeting, "campaign_of", lambda path: (evaluate_campaign(measured), None))
    text = """
part: part.yaml
points: [{name: near, xyz_mm: [0, 0, 0]}, {name: far, xyz_mm: [1500, 1000, 500]}]
u_ip: {campaign: campaign.yaml}
coverage_probability: 0.9545
"""
    budget = budget_from(load_sources(write(tmp_path, text)))
    xyz = np.array([[0, 0, 0], [1500, 1000, 500]], dtype=float)
    studies = point_studies(measured, xyz)
    for point in range(2):
        for axis in range(3):
            one = studies[point][axis]
            u = budget.combined.standard_uncertainty_mm[point, axis]
            assert u == pytest.approx(one.reproducibility)
            nu = one.degrees_of_freedom
            assert budget.combined.degrees_of_freedom[point, axis] == pytest.approx(nu)
            assert budget.expanded_mm[point, axis] == pytest.approx(
                u * stats.t.ppf(0.97725, nu), rel=1e-3
            )
    assert np.isfinite(budget.sampled.half_width_mm).all()
    # One contributor with Student's distribution: both say the same.
    assert budget.sampled.half_width_mm == pytest.approx(budget.expanded_mm, rel=0.01)


def test_the_larger_of_run_and_campaign_counts(
    bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(4)
    sigma = np.array([1e-9, 1e-9, 1e-9, 0.1, 1e-7, 1e-7, 1e-9])
    measured = [
        MeasuredRun(
            clamping=k,
            repeat=1,
            theta=np.array([0.0, 0, 0, 10, 20, 30, 0]) + random.normal(size=7) * sigma,
            covariance=np.diag(sigma**2),
        )
        for k in range(6)
    ]
    monkeypatch.setattr(budgeting, "campaign_of", lambda path: (evaluate_campaign(measured), None))
    text = f"part: {bench}/part.yaml\nu_ip: {{run: {bench}, campaign: campaign.yaml}}\n"
    budget = budget_from(load_sources(write(tmp_path, text)))
    freedom = budget.combined.degrees_of_freedom
    assert freedom[:, 0] == pytest.approx(5.0)
    assert np.isinf(freedom[:, 1:]).all()
    assert np.isfinite(budget.sampled.half_width_mm).all()


def test_what_helps_is_computed_again_and_the_largest_comes_first(
    bench: Path, tmp_path: Path
) -> None:
    text = f"""
part: {bench}/part.yaml
u_ip: {{run: {bench}}}
contributors:
  - {{name: fixture, distribution: uniform, half_width: 0.02, sensitivity: [1, 0, 0]}}
"""
    sources = load_sources(write(tmp_path, text))
    budget = budget_from(sources)
    helps = what_ifs(sources, budget)
    point, axis = budget.worst
    assert axis == 0
    # Half of the only large contributor halves U, but for what the run leaves.
    u_ip = budget.combined.standard_uncertainty_mm[point, 0] ** 2 - 0.02**2 / 3
    expected = 1 - math.sqrt((0.01**2 / 3 + u_ip) / (0.02**2 / 3 + u_ip))
    assert helps[0].what == "half of fixture"
    assert helps[0].gain == pytest.approx(expected)
    alone = load_sources(write(tmp_path, text[: text.index("contributors")]))
    gains = {one.what: one.gain for one in what_ifs(alone, budget_from(alone))}
    # Image noise alone acts in this run: twice the images, 1/√2 of U.
    assert gains["twice the images in the machine"] == pytest.approx(1 - 1 / math.sqrt(2), abs=0.03)
    # Stops that are anew each time: the same, though the images add nothing.
    (tmp_path / "machine.yaml").write_text(
        "machine: {name: m, urdf: m.urdf}\n"
        "uncertainty: {stop_sigma_mm: 0.02, geometry_sigma_mm: 0, geometry_length_mm: 500}\n"
    )
    declared = text[: text.index("contributors")] + "machine: machine.yaml\n"
    erring = load_sources(write(tmp_path, declared))
    only_u_ip = replace(erring, machine=None)
    gains = {one.what: one.gain for one in what_ifs(only_u_ip, budget_from(only_u_ip))}
    assert gains["twice the images in the machine"] == pytest.approx(1 - 1 / math.sqrt(2), abs=0.03)
    assert gains["a machine twice as exact at the stops"] == pytest.approx(0.5, abs=0.03)


def test_a_second_scale_bar_takes_half_of_the_scales_variance(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    places = random.uniform(-1000, 1000, (12, 3)) * [1, 1, 0.3]
    along = (places - places.mean(axis=0)).reshape(-1)
    scale, rest = 30e-6, 0.004
    covariance = scale**2 * np.outer(along, along) + rest**2 * np.eye(36)
    names = [str(i + 1) for i in range(12)]
    np.save(tmp_path / "full.npy", covariance)
    points = [
        {"name": n, "coded": True, "id": int(n), "xyz_mm": p.tolist(),
         "covariance_mm2": covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3].tolist()}
        for i, (n, p) in enumerate(zip(names, places))
    ]  # fmt: skip
    survey = {
        "target_family": "aicon12", "coded_dot_diameter_mm": 5, "points": points,
        "full_covariance": {"file": "full.npy", "order": names},
    }  # fmt: skip
    (tmp_path / "survey.json").write_text(json.dumps(survey))
    targets = "\n".join(
        f"  - {{id: {n}, xyz_mm: {p.tolist()}, dot_diameter_mm: 5}}" for n, p in zip(names, places)
    )
    (tmp_path / "part.yaml").write_text(
        f"part: {{name: block}}\ntarget_family: aicon12\ntargets:\n{targets}\n"
    )
    named = ", ".join(f"{{name: '{n}', xyz_mm: {p.tolist()}}}" for n, p in zip(names, places))
    sources = load_sources(
        write(tmp_path, f"part: part.yaml\npoints: [{named}]\nu_out: {{points: survey.json}}\n")
    )
    budget = budget_from(sources)
    point, axis = budget.worst
    reach = (places - places.mean(axis=0))[point, axis] ** 2 * scale**2
    gains = {one.what: one.gain for one in what_ifs(sources, budget)}
    expected = 1 - math.sqrt((reach / 2 + rest**2) / (reach + rest**2))
    assert gains["a second scale bar"] == pytest.approx(expected, abs=0.02)


def test_the_box_is_worst_at_its_farthest_corner(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(PART)
    sources = load_sources(write(tmp_path, BENCH))
    box_map = map_of(sources, steps=5)
    assert box_map.expanded_mm.shape == (5, 5, 5, 3)
    for axis, at in enumerate(([1500, 0, 0], [0, 1000, 0], [0, 0, 500])):
        place, largest = box_map.worst_of_axis(axis)
        assert place[axis] == at[axis]
        assert 1e3 * largest == pytest.approx([148.6, 151.8, 148.4][axis], abs=0.1)


def test_geometry_beyond_the_pose_is_nothing_for_errors_that_are_the_same_everywhere() -> None:
    stops = np.array([[x, y, 400.0] for x in (0, 1500) for y in (0, 1000)], dtype=float)
    seen = [(place - [0, 0, 300], [k]) for k, place in enumerate(stops)]
    at = np.array([[700.0, 500.0, 100.0], [1500.0, 1000.0, 100.0], [750.0, 500.0, -900.0]])
    tool = np.array([0.0, 0.0, -300.0])
    wide = geometry_left_mm(0.015, 1e6, stops, seen, at, tool)
    # What is left is how far errors differ over 1.5 m: σ d / l = 2e-5 mm.
    assert wide == pytest.approx(0.0, abs=3e-5)
    # Errors that have nothing to do with each other: the point's own, and the fit's (a quarter of
    # the variance in the targets' middle). Where a stop was, they are the same.
    narrow = geometry_left_mm(0.015, 1.0, stops, seen, at, tool)
    assert narrow[0] == pytest.approx(0.015 * math.sqrt(1.25), rel=0.01)
    assert np.all(narrow[1] < 0.015)
    assert np.all(narrow[2] > 0.015)
    near = geometry_left_mm(0.015, 700.0, stops, seen, at, tool)
    assert np.all(near[1] < near[2])
