"""The run of an independent program solves to micrometres, and its errors are as large as told."""

import json
import math
from pathlib import Path

from whole_suite import Omm

# mm and rad; issue: x, y 0.001 mm, z 0.003 mm, α, β 0.003 mm/m, γ 0.001 mm/m, γ_s 0.006 mm/m.
LARGEST_ERRORS = {
    "alpha_rad": 3e-6,
    "beta_rad": 3e-6,
    "gamma_rad": 1e-6,
    "x_mm": 0.001,
    "y_mm": 0.001,
    "z_mm": 0.003,
    "gamma_s_rad": 6e-6,
}


def test_every_parameter_is_within_its_bound_and_its_uncertainty(
    bench_run: Path, omm: Omm, tmp_path: Path
) -> None:
    omm("solve", bench_run, "--json", tmp_path / "out.json")
    result = json.loads((tmp_path / "out.json").read_text())
    truth = json.loads((bench_run / "truth.json").read_text())["theta"]
    assert result["rms_px"] < 0.003
    for i, (name, largest) in enumerate(LARGEST_ERRORS.items()):
        error = abs(result["theta"][name] - truth[name])
        assert error < largest, name
        assert error < 4.0 * math.sqrt(result["covariance"][i][i]), name


def test_with_the_angle_given_its_covariance_is_zero(
    bench_run: Path, omm: Omm, tmp_path: Path
) -> None:
    omm("solve", bench_run, "--model", "6d", "--json", tmp_path / "out.json")
    result = json.loads((tmp_path / "out.json").read_text())
    assert result["theta"]["gamma_s_rad"] == 0.0
    assert all(row[6] == 0.0 for row in result["covariance"])
    assert result["covariance"][6] == [0.0] * 7
