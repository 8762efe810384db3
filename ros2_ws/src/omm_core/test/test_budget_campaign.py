"""What a campaign is made of comes out of it again: scatter, drift, belief in the prediction."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omm_core.budget.campaign import MeasuredRun, evaluate_campaign, point_studies
from omm_core.budget.gauge import drift, gauge_capability, type_1
from omm_core.errors import InputError
from omm_core.geometry import RigidTransform

SIGMA = np.array([4e-6, 3e-6, 1e-6, 0.002, 0.003, 0.006, 5e-6])
THETA = np.array([0.002, -0.001, 0.003, -130.0, -150.0, -30.0, 0.001])


def campaign(random, clampings=10, repeats=10, clamping=0.0, scale=1.0, slope=0.0, truth=True):  # type: ignore[no-untyped-def]
    measured = []
    for k in range(clampings):
        turned = random.normal(size=7) * clamping * SIGMA
        for n in range(repeats):
            off = turned + random.normal(size=7) * scale * SIGMA + slope * k * SIGMA
            measured.append(
                MeasuredRun(
                    clamping=k,
                    repeat=n,
                    theta=THETA + off,
                    covariance=np.diag(SIGMA**2),
                    truth=THETA if truth else None,
                )
            )
    return measured


def test_a_true_prediction_is_believed_as_often_as_its_level_says() -> None:
    random = np.random.default_rng(1)
    for truth in (True, False):
        p = [
            evaluate_campaign(campaign(random, 5, 4, truth=truth)).prediction.p_value  # type: ignore[union-attr]
            for _ in range(300)
        ]
        assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.06)


@pytest.mark.parametrize("truth", [True, False])
def test_a_prediction_that_is_too_small_is_not_believed(truth: bool) -> None:
    random = np.random.default_rng(2)
    found = evaluate_campaign(campaign(random, scale=1.5, truth=truth)).prediction
    assert found is not None
    assert not found.believed
    assert found.ratio == pytest.approx(np.full(len(found.ratio), 1.5), rel=0.25)


def test_what_clampings_add_and_what_repeats_do_are_told_apart() -> None:
    random = np.random.default_rng(3)
    found = evaluate_campaign(campaign(random, 200, 3, clamping=2.0))
    for one, sigma in zip(found.quantities, SIGMA):
        assert one.study.repeatability == pytest.approx(sigma, rel=0.15)
        assert one.study.between == pytest.approx(2.0 * sigma, rel=0.2)
        assert one.study.p_value < 1e-6


def test_errors_that_all_runs_share_are_no_scatter_and_judged_once() -> None:
    random = np.random.default_rng(9)
    p_values, squared = [], []
    for _ in range(300):
        shared = random.normal(size=7) * SIGMA * math.sqrt(0.9)
        measured = [
            replace(m, theta=THETA + shared + (m.theta - THETA) * math.sqrt(0.1))
            for m in campaign(random, 4, 2)
        ]
        found = evaluate_campaign(measured).prediction
        assert found is not None
        p_values.append(found.bias_p_value)
        squared.append(found.squared_error)
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.09, abs=0.05)
    assert np.mean(squared) == pytest.approx(7.0, abs=0.7)


def test_drift_is_found_and_clampings_that_differ_are_not_taken_for_it() -> None:
    random = np.random.default_rng(4)
    assert evaluate_campaign(campaign(random, 12, 5, slope=0.5)).findings
    false = [
        drift(list(random.normal(0, 3, (8, 1)) + random.normal(size=(8, 5))))[0].p_value
        for _ in range(1000)
    ]
    assert np.mean(np.array(false) < 0.05) == pytest.approx(0.05, abs=0.025)


def test_repeats_that_drift_within_each_clamping_are_found() -> None:
    random = np.random.default_rng(5)
    values = [c + np.arange(6) * 0.8 + random.normal(size=6) for c in random.normal(0, 9, 6)]
    between, within = drift(values)
    assert not between.significant
    assert within.significant
    assert within.per_step == pytest.approx(0.8, abs=0.3)


def test_type_1_as_the_formulas_have_it() -> None:
    assert type_1(0.01, 2.0) == (pytest.approx(0.4 / 0.06), pytest.approx(math.nan, nan_ok=True))
    assert type_1(0.01, 2.0, -0.05)[1] == pytest.approx((0.2 - 0.05) / 0.03)
    assert type_1(0.01, 2.0, 0.3)[1] < 0.0
    assert type_1(0.0, 2.0, 0.1) == (math.inf, math.inf)
    with pytest.raises(InputError):
        type_1(0.1, 0.0)


def test_capability_of_a_campaign() -> None:
    random = np.random.default_rng(6)
    found = evaluate_campaign(campaign(random, 30, 4), tolerances={"z_mm": 0.5, "x_mm": 0.01})
    good, bad = found.quantity("z_mm"), found.quantity("x_mm")
    assert good.capability is not None
    assert good.capability.cg == pytest.approx(0.1 / (6 * 0.006), rel=0.2)
    assert good.capability.verdict == "capable"
    assert gauge_capability(bad.study, 0.01).verdict == "not capable"
    assert found.quantity("y_mm").capability is None


def test_points_move_as_the_pose_does() -> None:
    random = np.random.default_rng(7)
    measured = campaign(random, 6, 5, clamping=1.0, scale=20)
    xyz = np.array([[0.0, 0.0, 0.0], [1500.0, 1000.0, 500.0]])
    studies = point_studies(measured, xyz)
    moved = np.array(
        [
            RigidTransform.from_euler_xyz_rad(*m.theta[:3], translation_mm=m.theta[3:6]) @ xyz
            for m in measured
        ]
    )
    for p in range(2):
        for axis in range(3):
            groups = moved[:, p, axis].reshape(6, 5)
            within = math.sqrt(np.mean(np.var(groups, axis=1, ddof=1)))
            assert studies[p][axis].repeatability == pytest.approx(within, rel=1e-3)


def test_angles_about_a_half_turn_do_not_jump() -> None:
    random = np.random.default_rng(8)
    measured = [
        MeasuredRun(
            clamping=k,
            repeat=1,
            theta=np.where(np.arange(7) == 0, (np.pi + a + np.pi) % (2 * np.pi) - np.pi, 0.0),
            covariance=np.diag(SIGMA**2),
        )
        for k, a in enumerate(random.normal(0, 1e-3, 40))
    ]
    assert evaluate_campaign(measured).quantities[0].sigma == pytest.approx(1e-3, rel=0.3)


@pytest.mark.parametrize(("clampings", "repeats"), [(5, 5), (12, 1), (3, 4)])
def test_a_run_that_strays_is_named_and_no_other(clampings: int, repeats: int) -> None:
    random = np.random.default_rng(11)
    false = 0
    for _ in range(200):
        measured = campaign(random, clampings, repeats, clamping=2.0, truth=False)
        false += any("strays" in told for told in evaluate_campaign(measured).findings)
    # The level is 1 % of campaigns.
    assert false <= 7
    moved = replace(
        measured[-1], name="c/r", theta=measured[-1].theta + 40 * SIGMA * (np.arange(7) == 3)
    )
    told = [one for one in evaluate_campaign([*measured[:-1], moved]).findings if "strays" in one]
    assert len(told) == 1
    where = f"c/r (clamping {moved.clamping}, repeat {moved.repeat})"
    assert told[0].startswith(f"{where} strays: its x_mm")
