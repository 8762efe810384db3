"""Published worked examples of the GUM and its supplement 1 come out of the budget's engine.

Sources: JCGM 100:2008 (GUM) H.1; JCGM 101:2008 9.2, 9.4, 9.5.
"""

import math

import numpy as np
import pytest

from omm_core.budget.distributions import Distribution
from omm_core.budget.propagation import (
    Input,
    agree,
    first_order,
    monte_carlo,
    student_factor,
    tolerance_of,
)
from omm_core.budget.sources import pose_covariances, pose_jacobian


def normal(name: str, value: float, u: float, dof: float = math.inf) -> Input:
    return Input(
        name=name,
        value=value,
        distribution=Distribution(kind="normal", standard_uncertainty=u, degrees_of_freedom=dof),
    )


def bounded(name: str, kind: str, value: float, half: float, dof: float = math.inf) -> Input:
    return Input(name=name, value=value, distribution=Distribution.from_half_width(kind, half, dof))


def gauge_block(ls, d0, d1, d2, alpha, mean, cycle, d_alpha, d_theta):  # type: ignore[no-untyped-def]
    """GUM eq. H.2 with the temperature's cycle: l = ls + d - ls (δα θ + αs δθ), nm."""
    return ls + d0 + d1 + d2 - ls * (d_alpha * (mean + cycle) + alpha * d_theta)


GAUGE_BLOCK = [
    normal("ls", 50_000_623.0, 25.0, 18),
    normal("d0", 215.0, 5.8, 24),
    normal("d1", 0.0, 3.9, 5),
    normal("d2", 0.0, 6.7, 8),
    bounded("alpha", "uniform", 11.5e-6, 2e-6),
    normal("mean", -0.1, 0.2),
    bounded("cycle", "arcsine", 0.0, 0.5),
    bounded("d_alpha", "uniform", 0.0, 1e-6, 50),
    bounded("d_theta", "uniform", 0.0, 0.05, 2),
]


def test_gum_h1_gauge_block() -> None:
    result = first_order(gauge_block, GAUGE_BLOCK)
    assert result.value == pytest.approx(50_000_838, abs=0.5)
    assert result.standard_uncertainty == pytest.approx(31.66, abs=0.005)
    assert result.degrees_of_freedom == pytest.approx(16.75, abs=0.02)
    assert result.coverage_factor(0.99) * result.standard_uncertainty == pytest.approx(
        91.9, abs=0.1
    )
    whole = student_factor(0.99, math.floor(result.degrees_of_freedom))
    assert whole * result.standard_uncertainty == pytest.approx(92.5, abs=0.05)
    printed = {"ls": 25, "d0": 5.8, "d1": 3.9, "d2": 6.7, "d_alpha": 2.89, "d_theta": 16.6}
    for name, component in printed.items():
        assert result.components[name] == pytest.approx(component, rel=0.005)


def test_jcgm_101_9_5_gauge_block() -> None:
    result = monte_carlo(gauge_block, GAUGE_BLOCK, probability=0.99, trials=2_000_000)
    assert result.standard_uncertainty == pytest.approx(35.8, abs=0.15)
    assert result.low - 50_000_000 == pytest.approx(744, abs=1)
    assert result.high - 50_000_000 == pytest.approx(932, abs=1)


def total(*inputs):  # type: ignore[no-untyped-def]
    return sum(inputs)


@pytest.mark.parametrize(
    ("inputs", "u", "gum", "supplement", "same"),
    [
        ([normal(f"x{i}", 0.0, 1.0) for i in range(4)], 2.0, 3.92, 3.92, True),
        ([bounded(f"x{i}", "uniform", 0, math.sqrt(3)) for i in range(4)], 2.0, 3.92, 3.88, True),
        (
            [bounded(f"x{i}", "uniform", 0, math.sqrt(3)) for i in range(3)]
            + [bounded("x3", "uniform", 0, 10 * math.sqrt(3))],
            10.15,
            19.9,
            17.0,
            False,
        ),
    ],
    ids=["9.2.2 normal", "9.2.3 uniform", "9.2.4 one is larger"],
)
def test_jcgm_101_9_2_additive_model(inputs, u, gum, supplement, same) -> None:  # type: ignore[no-untyped-def]
    first = first_order(total, inputs)
    other = monte_carlo(total, inputs, probability=0.95, trials=2_000_000)
    assert first.standard_uncertainty == pytest.approx(u, abs=0.005)
    assert other.standard_uncertainty == pytest.approx(u, rel=0.003)
    factor = first.coverage_factor(0.95)
    assert factor * first.standard_uncertainty == pytest.approx(gum, abs=0.05)
    assert (other.high - other.low) / 2 == pytest.approx(supplement, abs=0.05 if u > 5 else 0.01)
    assert agree(first, other, factor) is same


@pytest.mark.parametrize(
    ("x1", "r", "y", "u", "low", "high"),
    [
        (0.0, 0.0, 50, 50, 0, 150),
        (0.0, 0.9, 50, 67, 0, 185),
        (0.05, 0.0, 2550, 503, 1587, 3541),
    ],
)
def test_jcgm_101_9_4_comparison_loss(x1, r, y, u, low, high) -> None:  # type: ignore[no-untyped-def]
    inputs = [normal("x1", x1, 0.005), normal("x2", 0.0, 0.005)]
    result = monte_carlo(
        lambda a, b: a**2 + b**2,
        inputs,
        correlation={("x1", "x2"): r} if r else None,
        shortest=True,
        trials=2_000_000,
    )
    assert result.value * 1e6 == pytest.approx(y, rel=0.005)
    assert result.standard_uncertainty * 1e6 == pytest.approx(u, rel=0.01)
    # The shortest interval's length is sharp, its place is flat: equally short ones lie about it.
    assert (result.high - result.low) * 1e6 == pytest.approx(high - low, abs=6)
    assert result.low * 1e6 == pytest.approx(low, abs=15)


@pytest.mark.parametrize(
    ("u", "delta"), [(2.0, 0.05), (10.15, 0.5), (0.00035, 5e-6), (9.97, 0.5), (99.6, 5.0)]
)
def test_jcgm_101_7_9_2_tolerance(u: float, delta: float) -> None:
    assert tolerance_of(u) == pytest.approx(delta)


def test_correlation_adds_as_in_gum_5_2() -> None:
    inputs = [normal("a", 1.0, 3.0), normal("b", 2.0, 4.0)]
    for r in (-1.0, -0.5, 0.3, 1.0):
        u = first_order(lambda a, b: 2 * a + b, inputs, {("a", "b"): r}).standard_uncertainty
        assert u == pytest.approx(math.sqrt(36 + 16 + 2 * r * 6 * 4), abs=1e-9)


# The paper's section 4: spread at a target (µm, X Y Z), 2σ of table 3's 7D (mm/m, mm), the volume.
# In industry the camera looks along Y instead of Z: y and z, β and γ change places.
PAPER_U_IP = {
    "bench": (
        [[0, 0, 0], [1500, 0, 0], [0, 1000, 0], [1500, 1000, 0]],
        (3.5, 14.3, 15.5), (0.028, 0.024, 0.010, 0.032, 0.030, 0.020),
        (1500, 1000, 500), (20.1, 27.4, 23.5),
    ),
    "industrial": (
        [[x, 0, z] for x in (0, 10000) for z in (0, 3000)],
        (3.5, 15.5, 14.3), (0.028, 0.010, 0.024, 0.032, 0.020, 0.030),
        (10000, 3000, 5000), (57.6, 140.2, 134.9),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PAPER_U_IP)
def test_the_papers_u_ip_in_size_by_what_it_tells_of_its_monte_carlo(name: str) -> None:
    """Spread at the targets through a rigid fit, and table 3's 7D: the worst corner, each axis."""
    targets, at_target_um, two_sigma, box, printed_um = PAPER_U_IP[name]
    jacobian = pose_jacobian([0.0] * 6, np.array(targets, dtype=float)).reshape(-1, 6)
    fit = np.linalg.pinv(jacobian)
    of_targets = fit @ np.diag(np.tile(np.square(at_target_um) * 1e-6, len(targets))) @ fit.T
    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0]) / 2.0
    of_pose = np.diag(np.square(np.array(two_sigma) * scale))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * box
    covariances = pose_covariances([0.0] * 6, of_targets + of_pose, corners)
    u_ip_um = 1e3 * np.sqrt(np.einsum("pii->pi", covariances)).max(axis=0)
    assert np.all(np.abs(np.log(u_ip_um / printed_um)) < np.log(2.0))
