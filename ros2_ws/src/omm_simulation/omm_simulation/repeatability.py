"""One part measured over many clampings of the camera, with 6D and with 7D (paper, Table 3).

Machine, part and calibration stay; the holder's angle and seat, the stops and the images are anew
with every clamping.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, MeasurementError
from omm_core.part_pose import Observation, SolveOptions, solve
from omm_core.session.measurement import Measurement
from omm_simulation.cell import Cell, draw
from omm_simulation.centres import observed_centres
from omm_simulation.offline import PoseMessage
from omm_simulation.offline import run as run_cell
from omm_simulation.scenario import Scenario

Floats = NDArray[np.float64]

# Twice the standard deviations of x, y, z (mm), α, β, γ, γ_s (mm/m): paper, Tables 2 and 3.
PAPER = {
    "paper 6D": (0.136, 0.056, 0.026, 0.039, 0.056, 0.070, None),
    "paper 7D": (0.032, 0.030, 0.020, 0.028, 0.024, 0.010, 3.840),
}
COLUMNS = ("x mm", "y mm", "z mm", "α mm/m", "β mm/m", "γ mm/m", "γ_s mm/m")
_THETA_OF_COLUMN = [3, 4, 5, 0, 1, 2, 6]
_UNITS = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3, 1e3])


@dataclass(frozen=True, kw_only=True, eq=False)
class Clamping:
    """One clamping: true and solved θ (7,), rad and mm."""

    truth: Floats
    six: Floats
    seven: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Repeatability:
    """What all clampings came to, (N, 7) each, in the order of θ."""

    truth: Floats
    six: Floats
    seven: Floats

    def rows(self) -> dict[str, tuple[float | None, ...]]:
        """Return twice the standard deviations in :data:`COLUMNS`' order.

        γ_s differs from clamping to clamping: of 7D what was measured, as in the paper.
        """
        six, seven = self._twice(self.six), self._twice(self.seven)
        return {"omm 6D": (*six[:6], None), "omm 7D": tuple(seven)}

    def gamma_s_error(self) -> float:
        """Return twice the standard deviation of 7D's error of γ_s, mm/m."""
        return float(2e3 * (self.seven - self.truth)[:, 6].std(ddof=1))

    @staticmethod
    def _twice(thetas: Floats) -> list[float]:
        return list((2.0 * thetas.std(axis=0, ddof=1)[_THETA_OF_COLUMN] * _UNITS).tolist())


def measure_clampings(
    scenario: Scenario, clampings: int, seed: int, *, sigma_px: float | None = None
) -> Iterator[Clamping]:
    """Measure clampings one after the other.

    Parameters
    ----------
    scenario, seed
        Which cell; each clamping has a seed of its own, beginning with this one.
    clampings : int
    sigma_px : float, optional
        Simulate centres with this noise; without it, images are rendered and searched.

    Raises
    ------
    InputError
        Where fewer than 2 clampings, or noise that is not above 0 px, are asked for.
    MeasurementError
        Where one of them has no solution.
    """
    if clampings < 2 or (sigma_px is not None and not sigma_px > 0.0):
        raise InputError(
            "Expected at least 2 clampings and noise above 0 px, got"
            f" {clampings} and {'images' if sigma_px is None else sigma_px}."
        )
    for number in range(clampings):
        cell = draw(scenario, seed, clamping_seed=seed + number)
        if sigma_px is None:
            observations = _from_images(cell)
        else:
            observations = observed_centres(cell, sigma_px, np.random.default_rng([seed, number]))
        six, seven = _both(observations, cell)
        yield Clamping(truth=np.array(list(cell.theta_own().values())), six=six, seven=seven)


def repeatability(clampings: Sequence[Clamping]) -> Repeatability:
    """Gather clampings."""
    return Repeatability(
        truth=np.array([c.truth for c in clampings]),
        six=np.array([c.six for c in clampings]),
        seven=np.array([c.seven for c in clampings]),
    )


def table(result: Repeatability) -> str:
    """Return the table beside the paper's."""
    rows = result.rows() | PAPER
    lines = [f"{'':9}" + "".join(f"{column:>10}" for column in COLUMNS)]
    lines += [
        f"{name:9}" + "".join(f"{'–':>10}" if v is None else f"{v:10.4f}" for v in row)
        for name, row in rows.items()
    ]
    six, seven = (np.array(rows[f"omm {name}"][:6], dtype=float) for name in ("6D", "7D"))
    factors = np.divide(six, seven, out=np.full(6, np.inf), where=seven > 0)
    lines.append(f"{'6D / 7D':9}" + "".join(f"{factor:10.1f}" for factor in factors))
    error = f"7D: 2 standard deviations of the error of γ_s: {result.gamma_s_error():.4f} mm/m"
    return "\n".join([*lines, "", error])


def _from_images(cell: Cell) -> Sequence[Observation]:
    """Return what is seen in rendered images, as the nodes would come to it."""
    measurement = Measurement(cell.scenario.part, cell.scenario.calibration)
    for message in run_cell(cell):
        if isinstance(message, PoseMessage):
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
        else:
            measurement.add_image(message.stamp_ns, message.image)
    return measurement.result().solution.observations


def _both(observations: Sequence[Observation], cell: Cell) -> list[Floats]:
    """Return θ of 6D (γ_s taken as 0, as in the paper's Table 2) and of 7D."""
    thetas = []
    for model in ("6d", "7d"):
        # Backlash makes 6D's residuals large: nothing is left out or refused for that here.
        options = SolveOptions(model=model, find_errors=model == "7d")
        solution = solve(observations, cell.scenario.part, cell.scenario.calibration, options)
        if not solution.determined:
            raise MeasurementError("; ".join(solution.missing))
        thetas.append(solution.theta)
    return thetas
