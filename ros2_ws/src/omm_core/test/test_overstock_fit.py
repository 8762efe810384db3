"""Fits of a block, from a survey to part.yaml: starts, findings, refusals, covariance."""

from dataclasses import replace

import numpy as np
import pytest
from overstock_samples import (
    CORNERS,
    SHIFT,
    SIZE,
    TURN,
    block_faces,
    fit_file,
    raw_points,
    survey,
)
from scipy.spatial.transform import Rotation

from omm_core.errors import InputError, MeasurementError
from omm_core.overstock import uncertainty
from omm_core.overstock.fit import fit_part
from omm_core.overstock.fit_file import FaceGroup, Tolerance
from omm_core.overstock.fit_words import fit_text, refuse
from omm_core.overstock.what_if import parse_changes, rows_of, what_if

STOCK = (3.0, 7.0, 8.0, 2.0, 6.0, 4.0)
PAD = ([700, 100, 300], [900, 200, 360])
PAD_STOCK = (3.0, 4.0, 3.0, 4.0, 5.0)


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    monkeypatch.setattr(uncertainty, "DRAWS", 12)


def fit(tmp_path, stock=STOCK, faces=None, change=None, given=None, sigma=0.02, **asked):
    faces = faces or block_faces()
    points, normals, _ = raw_points(faces, stock)
    if change is not None:
        points, normals = change(points.copy(), normals.copy())
    measured = survey(points, normals, sigma=sigma) if given is None else given
    return fit_part(faces, fit_file(tmp_path, **asked), measured), measured


def smallest(result):
    return [row["minimum_mm"] for row in result.document["groups"]]


def findings(result):
    return "\n".join(result.document["findings"])


def test_pairs_far_off_lead_to_the_exact_answer(tmp_path):
    result, _ = fit(tmp_path, off_mm=25.0)
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)
    assert result.document["feasible"]
    refuse(result)


def test_the_placement_maps_the_survey_to_the_part(tmp_path):
    result, _ = fit(tmp_path)
    told = result.document["part_T_survey"]
    rotation = Rotation.from_euler("xyz", told["euler_xyz_rad"]).as_matrix()
    assert np.abs(rotation @ TURN - np.eye(3)).max() < 1e-9
    # The blank's middle is moved onto the block's: 3/7, 8/2, 6/4.
    moved = rotation @ SHIFT + told["translation_mm"]
    assert moved == pytest.approx([-2.0, 3.0, 1.0], abs=1e-6)
    assert result.targets[0].xyz_mm == pytest.approx(CORNERS[0] + moved, abs=1e-6)


def test_coded_targets_with_nominal_places_are_a_start(tmp_path):
    nominal = {101 + n: p + 10.0 for n, p in enumerate(CORNERS)}
    result, _ = fit(tmp_path, pairs=False, nominal_targets=nominal)
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)


def test_from_nothing_the_one_placement_is_found(tmp_path):
    faces = block_faces(pad=PAD)
    result, _ = fit(tmp_path, (*STOCK, *PAD_STOCK), faces, pairs=False)
    told, _ = fit(tmp_path, (*STOCK, *PAD_STOCK), faces)
    assert result.choice.taken == 0
    assert result.document["minimum_margin_mm"] == pytest.approx(
        told.document["minimum_margin_mm"], abs=1e-6
    )
    assert result.targets[0].xyz_mm == pytest.approx(told.targets[0].xyz_mm, abs=1e-3)


def test_a_symmetric_part_has_four_placements_and_it_asks(tmp_path):
    result, measured = fit(tmp_path, pairs=False)
    assert len(result.choice.settled) == 4
    assert "placement 4 of 4" in findings(result)
    with pytest.raises(MeasurementError, match="4 placements fit as well"):
        refuse(result)
    asked = replace(result.problem.file, placement=3)
    refuse(fit_part(result.problem.faces, asked, measured))


def test_two_pairs_choose_among_symmetric_placements(tmp_path):
    file = fit_file(tmp_path)
    two = dict(list(file.pairs.items())[:2])
    points, normals, _ = raw_points(block_faces(), STOCK)
    measured = survey(points, normals)
    result = fit_part(block_faces(), replace(file, pairs=two), measured)
    assert len(result.choice.settled) <= 2  # the line through both is left to turn about
    told = fit_part(block_faces(), file, measured)
    places = [s.placement.pose[0] @ measured.points[0].xyz_mm for s in result.choice.settled]
    ours = told.settled.placement.pose[0] @ measured.points[0].xyz_mm
    assert min(np.linalg.norm(place - ours) for place in places) < 0.1


def test_what_is_missing_is_said_with_its_faces(tmp_path):
    result, _ = fit(tmp_path, (3.0, 7.0, -1.5, -1.0, 6.0, 4.0))
    document = result.document
    assert not document["feasible"]
    assert document["minimum_margin_mm"] == pytest.approx(-1.25, abs=1e-6)
    assert document["missing_mm"] == pytest.approx(2.5, abs=1e-4)
    assert sorted(document["limiting"]) == ["plane (0 -1 0) at 0.000", "plane (0 1 0) at 400.000"]
    alone = {r["group"]: r["lower_by_mm"] for r in document["remedies"]["alone"]}
    assert alone == pytest.approx(dict.fromkeys(document["limiting"], 2.5), abs=1e-4)
    assert "no placement helps" in findings(result)
    with pytest.raises(MeasurementError, match=r"2\.500 mm are missing"):
        refuse(result)


def test_lowering_an_allowance_by_what_is_told_is_enough_and_by_less_is_not(tmp_path):
    result, measured = fit(tmp_path, (3.0, 7.0, -1.5, -1.0, 6.0, 4.0))
    for by, enough in ((-2.501, True), (-2.499, False)):
        other = what_if(result, measured, {"plane (0 1 0) at 400.000": by})
        assert other.fit.document["feasible"] is enough
    rows = rows_of(result, other)
    assert rows[-1][:3] == ["smallest margin", "-1.250", "-0.001"]


def test_two_shortages_are_both_named(tmp_path):
    result, _ = fit(tmp_path, (3.0, 7.0, -1.5, -1.0, -0.5, -0.1))
    lacking = [words for words in result.document["findings"] if "lacks" in words]
    assert len(lacking) == 4
    assert sum(r["lower_by_mm"] for r in result.document["remedies"]["least"]) == pytest.approx(
        3.1, abs=1e-4
    )


def test_a_face_without_points_is_named_and_does_not_drift(tmp_path):
    result, _ = fit(tmp_path, (None, *STOCK[1:]))
    assert "no point on plane (-1 0 0) at 0.000" in findings(result)
    assert "nothing holds a shift along (1 0 0)" in findings(result)
    assert abs(result.targets[0].xyz_mm[0] - CORNERS[0][0]) < 1.0  # where the pairs had it
    with pytest.raises(MeasurementError, match="nothing holds"):
        refuse(result)


def test_a_datum_takes_the_place_of_a_face_without_points(tmp_path):
    group = FaceGroup(name="right", faces=(2,), datum_mm=4.0)
    result, _ = fit(tmp_path, (None, *STOCK[1:]), groups=(group,))
    row = result.document["groups"][0]
    assert (row["name"], row["minimum_mm"]) == ("right", pytest.approx(4.0, abs=1e-6))
    refuse(result)


def test_groups_are_chosen_by_what_faces_are(tmp_path):
    top = FaceGroup(name="top", kind="plane", normal=np.array([0, 0, 1.0]), minimum_mm=3.0)
    result, _ = fit(tmp_path, groups=(top,))
    low = {row["name"]: row["minimum_mm"] for row in result.document["groups"]}
    assert low["top"] == pytest.approx(6.5, abs=1e-6)
    assert low["plane (0 0 -1) at 0.000"] == pytest.approx(3.5, abs=1e-6)


def test_a_tolerance_between_groups_holds(tmp_path):
    groups = (FaceGroup(name="left", faces=(1,)), FaceGroup(name="right", faces=(2,)))
    tolerance = Tolerance(groups=("left", "right"), low_mm=1.0, high_mm=2.0)
    result, _ = fit(tmp_path, groups=groups, tolerances=(tolerance,))
    assert smallest(result)[:2] == pytest.approx([5.5, 4.5], abs=1e-6)


def test_a_limit_that_cannot_hold_is_refused(tmp_path):
    groups = tuple(FaceGroup(name=str(n), faces=(n,), maximum_mm=4.0) for n in (1, 2))
    result, _ = fit(tmp_path, groups=groups)
    assert not result.document["feasible"]
    with pytest.raises(MeasurementError, match=r"1\.000 mm over"):
        refuse(result)


def test_an_outlier_is_named_and_not_averaged_in(tmp_path):
    def deeper(points, normals):
        points[5] -= 15.0 * normals[5]
        return points, normals

    result, _ = fit(tmp_path, change=deeper)
    assert [entry["name"] for entry in result.document["left_out"]] == ["p6"]
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)
    kept, _ = fit(tmp_path, change=deeper, keep=("p6",))
    assert kept.document["left_out"] == []
    assert kept.document["minimum_margin_mm"] < 0.0


def test_a_point_whose_foil_looks_another_way_is_named(tmp_path):
    def turned(points, normals):
        normals[20] = -normals[20]
        points[40] += 200.0 * normals[40]
        return points, normals

    result, _ = fit(tmp_path, change=turned)
    assert [entry["name"] for entry in result.document["left_out"]] == ["p21", "p41"]
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)


def test_points_without_normals_find_their_faces(tmp_path):
    points, normals, _ = raw_points(block_faces(), STOCK)
    given = survey(points, normals, with_normals=False)
    result, _ = fit(tmp_path, given=given)
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)


@pytest.mark.parametrize(("factor", "words"), [(1 / 25.4, "inch"), (1e-3, "in m")])
@pytest.mark.parametrize("pairs", [True, False])
def test_a_wrong_unit_is_told(tmp_path, factor, words, pairs):
    points, normals, _ = raw_points(block_faces(), STOCK)
    measured = survey(points, normals)
    scaled = tuple(replace(p, xyz_mm=p.xyz_mm * factor) for p in measured.points)
    with pytest.raises(InputError, match=words):
        fit(tmp_path, given=replace(measured, points=scaled), pairs=pairs)


def test_mirrored_points_are_told(tmp_path):
    faces = block_faces(pad=PAD)
    points, normals, _ = raw_points(faces, (*STOCK, *PAD_STOCK))
    flip = np.diag([1.0, -1.0, 1.0])
    measured = survey(points @ flip, normals @ flip, coded=CORNERS @ flip)
    with pytest.raises(InputError, match="mirror image"):
        fit_part(faces, fit_file(tmp_path), measured)


def test_a_pair_that_contradicts_the_others_is_left_out(tmp_path):
    file = fit_file(tmp_path)
    pairs = dict(file.pairs) | {"102": file.pairs["102"] + [0.0, 300.0, 0.0]}
    points, normals, _ = raw_points(block_faces(), STOCK)
    result = fit_part(block_faces(), replace(file, pairs=pairs), survey(points, normals))
    assert "pair 102 does not fit the others" in findings(result)
    assert smallest(result) == pytest.approx([5] * 6, abs=1e-6)


def test_the_verdict_says_when_a_margin_is_not_proven(tmp_path):
    result, _ = fit(tmp_path, sigma=1.0, minimum_overstock_mm=4.9)
    verdicts = {row["verdict"] for row in result.document["groups"]}
    assert verdicts == {"not proven"}
    assert "not proven" in fit_text(result)


def test_sigma_of_overstock_is_that_of_the_point_along_the_normal(tmp_path):
    result, _ = fit(tmp_path, sigma=0.03)
    sigmas = [point["sigma_mm"] for point in result.document["points"]]
    assert sigmas == pytest.approx([0.03] * len(sigmas), rel=1e-9)


def test_noise_in_common_moves_no_target_in_the_part(tmp_path):
    """A shift of the whole survey is the survey's datum: part coordinates do not see it."""
    points, normals, _ = raw_points(block_faces(), STOCK)
    count = len(points) + len(CORNERS)
    common = np.kron(np.ones((count, count)), 0.5**2 * np.eye(3))
    own = 0.01**2 * np.eye(3 * count)
    alone, _ = fit(tmp_path, given=survey(points, normals, sigma=0.5))
    both, _ = fit(tmp_path, given=survey(points, normals, sigma=0.5, full=common + own))
    assert np.sqrt(np.diag(alone.covariance_mm2)).min() > 0.4
    assert np.sqrt(np.diag(both.covariance_mm2)).max() < 0.05


def test_the_covariance_of_targets_is_what_repeated_surveys_scatter(tmp_path, monkeypatch):
    monkeypatch.setattr(uncertainty, "DRAWS", 100)
    points, normals, _ = raw_points(block_faces(), STOCK, rough=0.3)
    result, _ = fit(tmp_path, given=survey(points, normals, sigma=0.05))
    monkeypatch.setattr(uncertainty, "draw", lambda *_: None)
    monkeypatch.setattr("omm_core.overstock.fit.draw", lambda *_: None)
    random = np.random.default_rng(3)
    places = []
    for _ in range(40):
        noisy = points + random.normal(0.0, 0.05, points.shape)
        coded = CORNERS + random.normal(0.0, 0.05, CORNERS.shape)
        again, _ = fit(tmp_path, given=survey(noisy, normals, sigma=None, coded=coded))
        places.append(np.concatenate([t.xyz_mm for t in again.targets]))
    scatter = np.var(places, axis=0, ddof=1).sum()
    assert np.trace(result.covariance_mm2) == pytest.approx(scatter, rel=0.35)


def test_least_squares_looks_at_no_allowance(tmp_path):
    result, _ = fit(tmp_path, criterion="least_squares")
    assert "for comparison" in findings(result)


@pytest.mark.parametrize("text", ["base", "base=", "=1", "base=nan"])
def test_what_if_says_what_it_expects(text):
    with pytest.raises(InputError, match="GROUP=MM"):
        parse_changes([text])


def test_what_if_wants_one_group(tmp_path):
    result, measured = fit(tmp_path)
    with pytest.raises(InputError, match="one group"):
        what_if(result, measured, {"plane": -1.0})
    assert what_if(result, measured, {"5": -1.0}).words.startswith("Allowance of plane (0 0 -1)")


def test_the_box_of_the_part_is_the_cads(tmp_path):
    result, _ = fit(tmp_path)
    assert result.box_mm == pytest.approx(np.array([[0, 0, 0], SIZE]))
