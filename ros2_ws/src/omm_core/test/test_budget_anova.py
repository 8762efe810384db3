"""Gauge studies: AIAG's published data, and variance components that are known."""

import numpy as np
import pytest

from omm_core.budget.anova import average_and_range, crossed, d2_star, one_factor
from omm_core.errors import InputError

# AIAG, Measurement Systems Analysis, 4th edition: 3 appraisers x 3 trials x 10 parts.
AIAG = """
.29 -.56 1.34 .47 -.80 .02 .59 -.31 2.26 -1.36 | .41 -.68 1.17 .50 -.92 -.11 .75 -.20 1.99 -1.25 |
.64 -.58 1.27 .64 -.84 -.21 .66 -.17 2.01 -1.31 ;
.08 -.47 1.19 .01 -.56 -.20 .47 -.63 1.80 -1.68 | .25 -1.22 .94 1.03 -1.20 .22 .55 .08 2.12 -1.62 |
.07 -.68 1.34 .20 -1.28 .06 .83 -.34 2.19 -1.50 ;
.04 -1.38 .88 .14 -1.46 -.29 .02 -.46 1.77 -1.49 |
-.11 -1.13 1.09 .20 -1.07 -.67 .01 -.56 1.45 -1.77 |
-.15 -.96 .67 .11 -1.45 -.49 .21 -.49 1.87 -2.16
"""
VALUES = np.array(
    [
        [[float(v) for v in trial.split()] for trial in appraiser.split("|")]
        for appraiser in AIAG.split(";")
    ]
)


def test_aiag_sums_of_squares_and_anova() -> None:
    study = crossed(VALUES)
    printed = {"appraiser": 3.1673, "part": 88.3619, "interaction": 0.3590, "equipment": 2.7589}
    for name, value in printed.items():
        assert study.sums_of_squares[name] == pytest.approx(value, abs=5e-5)
    assert study.sums_of_squares["total"] == pytest.approx(94.6471, abs=5e-5)
    assert study.pooled
    assert study.ev == pytest.approx(0.199933, abs=1e-6)
    assert study.av == pytest.approx(0.226838, abs=1e-6)
    assert study.grr == pytest.approx(0.302372, abs=1e-6)
    assert study.pv == pytest.approx(1.042327, abs=1e-6)
    assert study.tv == pytest.approx(1.085300, abs=1e-6)
    assert study.percent_grr == pytest.approx(27.86, abs=0.005)
    assert study.ndc == pytest.approx(4.86, abs=0.005)


def test_aiag_average_and_range() -> None:
    study = average_and_range(VALUES)
    printed = {"ev": 0.20186, "av": 0.22967, "grr": 0.30577, "pv": 1.10460, "tv": 1.14613}
    for name, value in printed.items():
        assert getattr(study, name) == pytest.approx(value, rel=0.001)
    assert study.percent_grr == pytest.approx(26.68, abs=0.03)
    assert study.ndc == pytest.approx(5.09, abs=0.01)


@pytest.mark.parametrize(
    ("size", "ranges", "printed"),
    [(2, 30, 1.128), (3, 30, 1.693), (3, 1, 1.91155), (10, 1, 3.17905), (2, 1, 1.41421)],
)
def test_d2_star_is_the_published_one(size: int, ranges: int, printed: float) -> None:
    assert d2_star(size, ranges) == pytest.approx(printed, rel=0.0005)


def test_components_that_were_put_in_come_out() -> None:
    random = np.random.default_rng(1)
    found = []
    for _ in range(400):
        clamping = random.normal(0, 2.0, 8)
        groups = [c + random.normal(0, 1.0, n) for c, n in zip(clamping, (5, 5, 5, 4, 6, 3, 5, 2))]
        study = one_factor(groups)
        found.append([study.repeatability**2, study.between**2, study.reproducibility**2])
    # Standard deviations of the means of 400: below 0.03, 0.13 and 0.13.
    assert np.mean(found, axis=0) == pytest.approx([1.0, 4.0, 5.0], abs=0.4)
    assert np.mean(found, axis=0)[0] == pytest.approx(1.0, abs=0.09)


def test_the_f_test_is_true_to_its_level_where_clampings_do_nothing() -> None:
    random = np.random.default_rng(2)
    p = [one_factor(random.normal(size=(6, 4))).p_value for _ in range(2000)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.02)


def test_the_reproducibility_covers_as_its_degrees_of_freedom_say() -> None:
    from scipy import stats

    random = np.random.default_rng(3)
    inside = []
    for _ in range(1500):
        study = one_factor(random.normal(0, 1.5, (6, 1)) + random.normal(size=(6, 4)))
        limit = stats.t.ppf(0.975, study.degrees_of_freedom) * study.reproducibility
        inside.append(abs(random.normal(0, np.hypot(1.5, 1.0))) < limit)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_what_cannot_be_known_is_not_told() -> None:
    single = one_factor([[1.0], [2.0], [4.0]])
    assert np.isnan(single.repeatability)
    assert single.reproducibility == pytest.approx(np.std([1, 2, 4], ddof=1))
    alone = one_factor([[1.0, 2.0, 4.0]])
    assert np.isnan(alone.reproducibility)
    assert alone.repeatability == pytest.approx(np.std([1, 2, 4], ddof=1))
    with pytest.raises(InputError):
        one_factor([[1.0]])
