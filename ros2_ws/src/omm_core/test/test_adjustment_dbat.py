"""The adjustment of 21 photographs of a sheet ends where DBAT's does, with the same sigma.

Data and result: DBAT's camcaldemo (Börlin and Grussenmeyer). Four control points are fixed, 9
interior unknowns, 21 stations and 96 points free.
"""

import csv
import re

import numpy as np
import pytest
from whole_suite import shared_data

from omm_core.adjustment import Block, Group, Problem, solve

DEMO = shared_data("survey/dbat_camcaldemo")
STEP = 1e-30  # complex step: exact derivatives
MM_PER_PX = 5.43764 / 1704
# cc, px, py (mm), aspect, K1 to K3, P1, P2 and their sigma, of DBAT's result (mm)
PUBLISHED = np.array(
    [7.456995, 3.616871, 2.613293, 3.89598e-4, 4.58861e-3, -4.51351e-5, -2.05253e-6,
     -6.12803e-5, -4.41171e-5]
)  # fmt: skip
SIGMA = np.array(
    [0.001046, 0.000822, 0.000980, 2.08e-5, 2.21e-5, 2.65e-6, 1.006e-7, 3.52e-6, 3.94e-6]
)


def _table(name):
    lines = (DEMO / name).read_text().splitlines()
    return list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))


def _stations():
    """Values of DBAT's report, (21, 6): omega, phi, kappa (rad) and place."""
    text = (DEMO / "report.txt").read_text()
    names = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
    found = [re.findall(rf"{name}:\n\s+Value:\s+(\S+)", text) for name in names]
    values = np.array(found, dtype=float).T
    values[:, :3] = np.radians(values[:, :3])
    return values


def _rotated(angles, v):
    """R3(kappa) R2(phi) R1(omega) v, of turning axes; complex numbers pass."""
    for axis, angle in zip((0, 1, 2), angles.T, strict=True):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        c, s, v = np.cos(angle), np.sin(angle), v.copy()
        v[:, a], v[:, b] = c * v[:, a] + s * v[:, b], c * v[:, b] - s * v[:, a]
    return v


def _misfit(pixels, lens, station, point):
    """Where the point should be minus the corrected measurement, px, (m, 2)."""
    cc, px, py, aspect, k1, k2, k3, p1, p2 = lens.T
    x = pixels[:, 0] * MM_PER_PX * (1 + aspect) - px
    y = py - pixels[:, 1] * MM_PER_PX
    r2 = x * x + y * y
    radial = r2 * (k1 + r2 * (k2 + r2 * k3))
    corrected_x = x + x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    corrected_y = y + y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    seen = _rotated(station[:, :3], point - station[:, 3:])
    ideal = -cc[:, None] * seen[:, :2] / seen[:, 2:]
    misfit = ideal - np.stack([corrected_x, corrected_y], axis=1)
    return misfit / MM_PER_PX


def _with_derivatives(pixels, arguments):
    """The misfit, and by each argument (m, k) its derivative (m, 2, k)."""
    rows = {name: values.astype(complex) for name, values in arguments.items()}
    derivatives = {}
    for name, values in rows.items():
        columns = []
        for k in range(values.shape[1]):
            moved = values.copy()
            moved[:, k] += 1j * STEP
            columns.append(_misfit(pixels, **{**rows, name: moved}).imag / STEP)
        derivatives[name] = np.stack(columns, axis=2)
    return _misfit(pixels, **rows).real, derivatives


def _problem():
    marks = np.array(_table("markpts.txt"), dtype=float)
    names, row = np.unique(marks[:, 1], return_inverse=True)
    pixels, station = marks[:, 2:4], marks[:, 0].astype(int) - 1
    control = {float(r[0]): [float(v) for v in r[2:]] for r in _table("camcal-fixed.txt")}
    held = np.isin(names, list(control))
    points = np.full((len(names), 3), [0.5, 0.5, 0.0])  # all on the sheet's middle
    points[held] = [control[name] for name in names[held]]
    rng = np.random.default_rng(1)
    stations = _stations() + rng.normal(0, 0.01, (21, 6))  # 0.6 degrees and 1 % of the sheet
    lens = np.array([[7.5, 1136 * MM_PER_PX, 852 * MM_PER_PX, 0, 0, 0, 0, 0, 0]])
    every = {"lens": np.zeros(len(marks), dtype=int), "station": station, "point": row}

    def evaluate(values):
        return _with_derivatives(pixels, {n: values[n][index] for n, index in every.items()})

    return Problem(
        groups=(
            Group(name="lens", values=lens),
            Group(name="station", values=stations),
            Group(name="point", values=points, held=np.tile(held[:, None], (1, 3))),
        ),
        blocks=(
            Block(
                name="marks",
                observed=np.zeros_like(pixels),
                covariance=np.einsum("m,ij->mij", marks[:, 4] ** 2, np.eye(2)),
                index=every,
                evaluate=evaluate,
            ),
        ),
    )


def test_values_and_sigma_are_those_of_dbat():
    solution = solve(_problem())
    assert solution.converged
    assert solution.degrees_of_freedom == 3725
    assert np.sqrt(solution.cost) == pytest.approx(98.5560, abs=1e-4)
    assert solution.sigma0 == pytest.approx(1.614805, abs=2e-6)
    assert np.abs((solution.values["lens"][0] - PUBLISHED) / SIGMA).max() < 0.002
    sigma = solution.sigma0 * np.sqrt(np.diag(solution.covariance_of("lens")))
    assert sigma == pytest.approx(SIGMA, rel=0.005)  # told to three digits
    sigma = solution.sigma0 * np.sqrt(np.diag(solution.covariance_of("station")))
    assert sigma[3:6] == pytest.approx([0.000155, 0.000179, 0.000207], abs=5e-7)
    assert solution.values["station"] == pytest.approx(_stations(), abs=2e-6)
