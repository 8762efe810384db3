"""Adjustments end where DBAT's do, with the same sigma (Börlin and Grussenmeyer).

camcaldemo: 21 photographs of a sheet; four control points are fixed, 9 interior unknowns, 21
stations and 96 points free. sxb: five aerial photographs; the camera is fixed, 14 control points
are observed, marks have two sigmas.
"""

import csv
import re

import numpy as np
import pytest
from whole_suite import shared_data

from omm_core.adjustment import Block, Group, Problem, solve

DEMO = shared_data("survey/dbat_camcaldemo")
AERIAL = shared_data("survey/dbat_sxb")
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


def _table(file):
    lines = file.read_text().splitlines()
    return list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))


def _stations(folder, what="Value"):
    """Values or deviations of DBAT's report, (n, 6): omega, phi, kappa (rad) and place."""
    text = (folder / "report.txt").read_text()
    names = ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
    told = rf":\n(?:\s+Value:.*\n)?\s+{what}:\s+(\S+)"
    values = np.array([re.findall(name + told, text) for name in names], dtype=float).T
    values[:, :3] = np.radians(values[:, :3])
    return values


def _rotated(angles, v):
    """R3(kappa) R2(phi) R1(omega) v, of turning axes; complex numbers pass."""
    for axis, angle in zip((0, 1, 2), angles.T, strict=True):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        c, s, v = np.cos(angle), np.sin(angle), v.copy()
        v[:, a], v[:, b] = c * v[:, a] + s * v[:, b], c * v[:, b] - s * v[:, a]
    return v


def _misfit(pixels, mm_per_px, lens, station, point):
    """Where the point should be minus the corrected measurement, px, (m, 2)."""
    cc, px, py, aspect, k1, k2, k3, p1, p2 = lens.T
    x = pixels[:, 0] * mm_per_px * (1 + aspect) - px
    y = py - pixels[:, 1] * mm_per_px
    r2 = x * x + y * y
    radial = r2 * (k1 + r2 * (k2 + r2 * k3))
    corrected_x = x + x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    corrected_y = y + y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    seen = _rotated(station[:, :3], point - station[:, 3:])
    ideal = -cc[:, None] * seen[:, :2] / seen[:, 2:]
    misfit = ideal - np.stack([corrected_x, corrected_y], axis=1)
    return misfit / mm_per_px


def _marks_block(pixels, sigma, mm_per_px, index):
    """The measured marks, with exact derivatives by all of their arguments."""

    def evaluate(values):
        rows = {name: values[name][where].astype(complex) for name, where in index.items()}
        derivatives = {}
        for name, row in rows.items():
            columns = []
            for k in range(row.shape[1]):
                moved = row.copy()
                moved[:, k] += 1j * STEP
                seen = _misfit(pixels, mm_per_px, **{**rows, name: moved})
                columns.append(seen.imag / STEP)
            derivatives[name] = np.stack(columns, axis=2)
        return _misfit(pixels, mm_per_px, **rows).real, derivatives

    return Block(
        name="marks",
        observed=np.zeros_like(pixels),
        covariance=np.einsum("m,ij->mij", sigma**2, np.eye(2)),
        index=index,
        evaluate=evaluate,
    )


def _sheet():
    marks = np.array(_table(DEMO / "markpts.txt"), dtype=float)
    names, row = np.unique(marks[:, 1], return_inverse=True)
    index = {"lens": np.zeros_like(row), "station": marks[:, 0].astype(int) - 1, "point": row}
    control = {float(r[0]): [float(v) for v in r[2:]] for r in _table(DEMO / "camcal-fixed.txt")}
    held = np.isin(names, list(control))
    points = np.full((len(names), 3), [0.5, 0.5, 0.0])  # all on the sheet's middle
    points[held] = [control[name] for name in names[held]]
    rng = np.random.default_rng(1)
    stations = _stations(DEMO) + rng.normal(0, 0.01, (21, 6))  # 0.6 degrees and 1 % of the sheet
    lens = np.array([[7.5, 1136 * MM_PER_PX, 852 * MM_PER_PX, 0, 0, 0, 0, 0, 0]])
    return Problem(
        groups=(
            Group(name="lens", values=lens),
            Group(name="station", values=stations),
            Group(name="point", values=points, held=np.tile(held[:, None], (1, 3))),
        ),
        blocks=(_marks_block(marks[:, 2:4], marks[:, 4], MM_PER_PX, index),),
    )


def _aerial():
    """The block, the numbers of its points, and which of them are control points."""
    tables = [_table(AERIAL / name) for name in ("markpts.txt", "smartpts.txt")]
    marks = np.array([row for table in tables for row in table], dtype=float)
    sigma = np.repeat([0.5, 1.0], [len(table) for table in tables])
    names, row = np.unique(marks[:, 0], return_inverse=True)
    index = {"lens": np.zeros_like(row), "station": marks[:, 1].astype(int) - 1, "point": row}
    control = {int(r[0]): [float(v) for v in r[2:]] for r in _table(AERIAL / "sxb-control.txt")}
    for checked in (351, 410):
        del control[checked]
    observed = np.isin(names, list(control))
    told = np.array([control[name] for name in names[observed]])
    points = np.tile(told[:, :3].mean(axis=0), (len(names), 1))  # all in the block's middle
    points[observed] = told[:, :3]
    spread = np.full_like(points, np.inf)
    spread[observed] = told[:, 3:]
    rng = np.random.default_rng(1)
    stations = _stations(AERIAL) + rng.normal(0, 1, (5, 6)) * np.repeat([0.01, 10.0], 3)
    lens = np.array([[123.9392, 26.577, 38.811, 0, 0, 0, 0, 0, 0]])
    problem = Problem(
        groups=(
            Group(name="lens", values=lens, fixed=True),
            Group(name="station", values=stations),
            Group(name="point", values=points, sigma=spread),
        ),
        blocks=(_marks_block(marks[:, 2:4], sigma, 0.006, index),),
    )
    return problem, names


def _posterior(folder, of):
    """Coordinates and sigma of DBAT's control or check points, number -> (6,)."""
    text = (folder / "report.txt").read_text()
    rows = text.split(of)[1].split("Posterior")[1].split("Diff")[0].splitlines()[2:]
    table = [[float(v) for v in row.split(",")[:7]] for row in rows if row.count(",") > 6]
    return {int(row[0]): np.array(row[1:]) for row in table}


def test_values_and_sigma_are_those_of_dbat():
    solution = solve(_sheet())
    assert solution.converged
    assert solution.degrees_of_freedom == 3725
    assert np.sqrt(solution.cost) == pytest.approx(98.5560, abs=1e-4)
    assert solution.sigma0 == pytest.approx(1.614805, abs=2e-6)
    assert np.abs((solution.values["lens"][0] - PUBLISHED) / SIGMA).max() < 0.002
    sigma = solution.sigma0 * np.sqrt(np.diag(solution.covariance_of("lens")))
    assert sigma == pytest.approx(SIGMA, rel=0.005)  # told to three digits
    sigma = solution.sigma0 * np.sqrt(np.diag(solution.covariance_of("station")))
    assert sigma[3:6] == pytest.approx([0.000155, 0.000179, 0.000207], abs=5e-7)
    assert solution.values["station"] == pytest.approx(_stations(DEMO), abs=2e-6)


def test_an_aerial_block_with_observed_control_points_is_that_of_dbat():
    problem, names = _aerial()
    solution = solve(problem)
    assert solution.converged
    assert solution.degrees_of_freedom == 1261
    assert 0.5 * solution.sigma0 == pytest.approx(0.589299, abs=1e-6)
    assert np.sqrt(solution.cost) == pytest.approx(41.8527, abs=1e-4)
    assert np.abs(solution.values["station"] - _stations(AERIAL)).max() < 2e-6
    sigma = solution.sigma0 * np.sqrt(np.diag(solution.covariance))
    of_stations = sigma[solution.slices["station"]].reshape(-1, 6)
    assert of_stations == pytest.approx(_stations(AERIAL, "Deviation"), rel=0.005)  # three digits
    of_points = sigma[solution.slices["point"]].reshape(-1, 3)
    told = {**_posterior(AERIAL, "Ctrl meas"), **_posterior(AERIAL, "Check meas")}
    assert len(told) == 16
    rows = np.searchsorted(names, list(told))
    expected = np.array(list(told.values()))
    assert (
        np.abs(solution.values["point"][rows] - expected[:, :3]).max() < 6e-4
    )  # told to a millimetre
    assert of_points[rows] == pytest.approx(expected[:, 3:], rel=0.005)
