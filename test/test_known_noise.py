"""The solver that knows all noise gives the standard deviations of an independent program.

It is what every U is compared with, and with it the definition of own coordinates: the truth of
the shared machines holds what a solver of another program's author found with all noise known.
"""

import json

import numpy as np
import pytest
from known_noise import KnownNoise, solve_knowing_all
from whole_suite import shared_data

from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_core.machine_errors import geometry_covariance
from omm_runs.recorded_observations import observations_of_run

# Stops, geometry, its length, targets in mm, as the data's README tells them; the length by trial.
MACHINES = {"shop": (0.003, 0.015, 700.0, 0.020), "shoplarge": (0.004, 0.030, 2000.0, 0.040)}


@pytest.mark.parametrize("name", MACHINES)
def test_standard_deviations_are_those_that_the_other_program_told(name: str) -> None:
    folder = shared_data(f"machines/{name}")
    stop, geometry, length, target = MACHINES[name]
    truth = json.loads((folder / "truth.json").read_text())
    part, camera = load_part(folder / "part.yaml"), load_calibration(folder / "camera.yaml")
    seen = observations_of_run(
        folder / "run.mcap", part, (camera.height_px, camera.width_px)
    ).observations
    ids = [t.id for t in part.targets]
    spindles = [o.machine_T_spindle for o in seen]  # one target an image
    found = solve_knowing_all(
        np.array(list(truth["theta"].values())),
        np.array([t.xyz_mm for t in part.targets]),
        np.arange(len(seen)),
        np.array([ids.index(o.target_id) for o in seen]),
        spindles,
        camera,
        [o.center_px for o in seen],
        KnownNoise(
            image_sigma_px=0.005,
            stop_sigma_mm=stop,
            geometry=geometry_covariance([s.translation_mm for s in spindles], geometry, length),
            target_sigma_mm=target,
        ),
    )
    absolute, own = np.array(truth["ideal_sigma"]), np.array(truth["ideal_own_sigma"])
    np.testing.assert_allclose(np.sqrt(np.diag(found.absolute_covariance)), absolute, rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(found.own_covariance)), own, rtol=1e-3)
    true_own = np.array(list(truth["theta_own"].values()))
    assert np.all(np.abs(found.own - true_own) < 3.0 * own)
