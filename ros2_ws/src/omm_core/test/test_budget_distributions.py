"""Samples have the spread and the correlation that a budget asks for; both intervals are judged."""

import itertools
import math

import numpy as np
import pytest

from omm_core.budget.distributions import KINDS, Distribution
from omm_core.budget.evaluation import Contribution, combine, sample
from omm_core.budget.propagation import draw, normal_correlation

PAIRS = list(itertools.combinations_with_replacement(KINDS, 2))


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_samples_have_the_wanted_correlation_whatever_their_distributions(
    first: str, second: str
) -> None:
    spreads = [Distribution(kind=kind, standard_uncertainty=1.0) for kind in (first, second)]
    wanted = np.array([[1.0, -0.85], [-0.85, 1.0]])
    seen = draw(spreads, wanted, np.random.default_rng(1), 200_000)
    assert seen.std(axis=1) == pytest.approx(1.0, abs=0.005)
    # (1 - r²)/√n is 0.0006 for normal ones, and the same in size for others.
    assert np.corrcoef(seen)[0, 1] == pytest.approx(-0.85, abs=0.003)


@pytest.mark.parametrize("r", [-0.95, -0.3, 0.5, 0.99])
def test_the_normal_correlation_is_that_of_the_closed_forms(r: float) -> None:
    assert normal_correlation("normal", "normal", r) == r
    uniform = normal_correlation("uniform", "uniform", r)
    assert uniform == pytest.approx(2.0 * math.sin(math.pi * r / 6.0), abs=1e-4)
    mixed = normal_correlation("normal", "uniform", r)
    assert mixed == pytest.approx(np.clip(r * math.sqrt(math.pi / 3.0), -1.0, 1.0), abs=1e-4)


@pytest.mark.parametrize(("word", "kind"), [("Rectangular", "uniform"), ("U-Shaped", "arcsine")])
def test_a_distribution_is_known_by_its_other_names_and_in_capitals(word: str, kind: str) -> None:
    assert Distribution.from_half_width(word, 1.0) == Distribution.from_half_width(kind, 1.0)


@pytest.mark.parametrize(
    ("kinds", "sizes", "agrees"),
    [
        (("normal",) * 4, (1.0,) * 4, True),
        (("uniform",) * 4, (1.0,) * 4, True),
        (("uniform",) * 4, (1.0, 1.0, 1.0, 10.0), False),
    ],
    ids=["9.2.2 normal", "9.2.3 uniform", "9.2.4 one is larger"],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_budget_of_jcgm_101_9_2_has_the_published_verdict(
    kinds: tuple[str, ...], sizes: tuple[float, ...], agrees: bool, seed: int
) -> None:
    contributions = [
        Contribution(
            name=f"x{i}",
            group="other",
            millimetres=np.array([[size, 0.0, 0.0]]),
            shape=Distribution(kind=kind, standard_uncertainty=1.0),
        )
        for i, (kind, size) in enumerate(zip(kinds, sizes))
    ]
    found = sample(contributions, {}, combine(contributions, {}), seed=seed)
    assert bool(found.agrees[0, 0]) is agrees
    if sizes[3] == 1.0 and kinds[0] == "uniform":
        # Irwin-Hall, n = 4: the upper tail t⁴/24 holds 2.275 % at t = 0.8597.
        tail = (1.0 - math.erf(math.sqrt(2.0))) / 2.0
        exact = (2.0 - (24.0 * tail) ** 0.25) * 2.0 * math.sqrt(3.0)
        assert found.half_width_mm[0, 0] == pytest.approx(exact, abs=0.01)
