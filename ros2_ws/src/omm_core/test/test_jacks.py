"""Jacks turned as told bring the part to its nominal pose; decisions by ISO 14253-1."""

import numpy as np
import pytest

from omm_core.alignment.jacks import Jack, jack_corrections, remarks
from omm_core.alignment.tolerance import decide
from omm_core.errors import InputError
from omm_core.geometry import RigidTransform

CORNERS = [(-4000, -1000), (4000, -1000), (4000, 1000), (-4000, 1000)]
JACKS = [Jack(name=f"J{k}", xyz_mm=np.array([x, y, 0.0])) for k, (x, y) in enumerate(CORNERS)]
NOTHING = np.zeros((6, 6))


def _corrections(deviation, mode="exact", **more):  # type: ignore[no-untyped-def]
    return [c.correction_mm for c in jack_corrections(JACKS, deviation, NOTHING, mode=mode, **more)]


@pytest.mark.parametrize(
    ("deviation", "expected"),
    [
        ([1e-3, 0, 0, 0, 0, 0], [1, 1, -1, -1]),
        ([0, 1e-3, 0, 0, 0, 0], [-4, 4, 4, -4]),
        ([0, 0, 0, 0, 0, -0.3], [0.3, 0.3, 0.3, 0.3]),
        ([0, 0, 1e-3, 5, 6, 0], [0, 0, 0, 0]),
    ],
)
def test_worked_corrections(deviation: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(_corrections(deviation), expected, atol=1e-12)


def test_tilt_only_leaves_the_height() -> None:
    both = [1e-3, 2e-3, 0, 0, 0, 0.7]
    np.testing.assert_allclose(_corrections(both, "tilt"), _corrections([*both[:5], 0.0]))


def test_lift_only_lets_no_jack_down() -> None:
    lifted = np.array(_corrections([1e-3, 2e-3, 0, 0, 0, 0.7], "lift"))
    exact = np.array(_corrections([1e-3, 2e-3, 0, 0, 0, 0.7]))
    assert lifted.min() == 0.0
    np.testing.assert_allclose(lifted - lifted[0], exact - exact[0], atol=1e-12)


@pytest.mark.parametrize("start", [5e-3, -3e-3])
def test_two_corrections_level_a_part_from_5_mm_per_m(start: float) -> None:
    pose = RigidTransform.from_euler_xyz_rad(start, -0.8 * start, 0.0, [0.0, 0.0, 2.0])
    for _ in range(2):
        alpha, beta, _gamma = pose.euler_xyz_rad()
        told = _corrections([alpha, beta, 0.0, 0.0, 0.0, pose.translation_mm[2]])
        heights = [(pose @ jack.xyz_mm)[2] + c for jack, c in zip(JACKS, told, strict=True)]
        # The plane on the jacks' heads, by least squares: the part lies on it.
        plane = np.linalg.lstsq(
            np.array([[x, y, 1.0] for x, y in CORNERS]), np.array(heights), rcond=None
        )[0]
        pose = RigidTransform.from_euler_xyz_rad(
            np.arctan(plane[1]), -np.arctan(plane[0]), 0.0, [0.0, 0.0, plane[2]]
        )
    assert np.max(np.abs(pose.euler_xyz_rad())) < 5e-5


def test_uncertainty_is_that_of_drawn_deviations() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2])[:, None]
    drawn = (root @ rng.normal(size=(6, 20_000))).T
    sigma = np.array([_corrections(d) for d in drawn[:4000]]).std(axis=0)
    told = [c.expanded_uncertainty_mm for c in jack_corrections(JACKS, np.zeros(6), root @ root.T)]
    np.testing.assert_allclose(told, 2.0 * sigma, rtol=0.05)


def test_lowest_jack_of_lift_only_is_certain() -> None:
    told = jack_corrections(JACKS, [1e-3, 2e-3, 0, 0, 0, 0], np.eye(6), mode="lift")
    lowest = min(told, key=lambda c: c.correction_mm)
    assert lowest.expanded_uncertainty_mm == 0.0


def test_up_turns_with_the_machine() -> None:
    lying = [Jack(name=j.name, xyz_mm=np.roll(j.xyz_mm, 1)) for j in JACKS]
    told = jack_corrections(lying, [0, 1e-3, 0, 0.3, 0, 0], NOTHING, up=[1, 0, 0])
    np.testing.assert_allclose([c.correction_mm for c in told], [0.7, 0.7, -1.3, -1.3])


def test_travel_and_a_fourth_jack_are_told() -> None:
    jacks = [Jack(name=j.name, xyz_mm=j.xyz_mm, travel_mm=(-0.5, 2.0)) for j in JACKS]
    told = remarks(jacks, jack_corrections(jacks, [1e-3, 0, 0, 0, 0, 0], NOTHING))
    assert [line.split(":")[0] for line in told] == ["J2", "J3", "4 jacks"]


@pytest.mark.parametrize("kept", [[0, 1], [0, 1, 1]])
def test_jacks_in_one_line_are_refused(kept: list[int]) -> None:
    with pytest.raises(InputError, match="one line"):
        jack_corrections([JACKS[k] for k in kept], np.zeros(6), NOTHING)


@pytest.mark.parametrize(
    ("deviation", "u", "state", "advice"),
    [
        (0.6, 0.4, "inside", "good enough"),
        (-0.7, 0.4, "not proven", "correct"),
        (-1.5, 0.4, "outside", "correct"),
        (0.7, 0.41, "not proven", "measure better first"),
        (float("nan"), 0.1, "not proven", "correct"),
    ],
)
def test_decision(deviation: float, u: float, state: str, advice: str) -> None:
    decision = decide(deviation, u, 1.0)
    assert (decision.state, decision.advice) == (state, advice)
