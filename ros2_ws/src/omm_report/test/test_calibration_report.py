"""The document of a calibration carries its numbers, and is the same for the same result."""

import io
import json

import numpy as np
import pikepdf

from omm_core.camera_calibration.model import Sensor
from omm_core.camera_calibration.result import CalibrationResult, DotObservation
from omm_core.camera_calibration.seven import result_sigma
from omm_report.calibration_figures import calibration_figures, write_pictures
from omm_report.calibration_report import calibration_document
from omm_report.calibration_text import calibration_lines


def _result() -> CalibrationResult:
    camera = np.array([6.2, -8, 27, 3e-8, -2e-15, -6e-8, 3e-7, -2, 0.3, -320, 3.13, -0.009, 0.03])
    sigma = np.array([1e-4, 0.1, 0.1, 1e-11, 1e-18, 1e-9, 1e-9, 1e-3, 1e-3, 500, 1e-5, 1e-5, 1e-5])
    seen = tuple(
        DotObservation(
            image=str(i), pixel=np.array([90.0 * i, 70.0 * i]), residual_px=np.ones(2) / 99
        )
        for i in range(20)
    )
    return CalibrationResult(
        sensor=Sensor(name="test", width_px=2592, height_px=1944, pixel_size_mm=0.0022),
        camera=camera,
        covariance=np.diag(sigma**2),
        sigma0=1.0,
        degrees_of_freedom=27,
        converged=True,
        observations=seen,
        images=20,
        covered_mm=(200.0, 400.0),
        undetermined=("z_mm",),
    )


def test_the_document_carries_the_result() -> None:
    content = calibration_document(_result(), "set")
    with pikepdf.open(io.BytesIO(content)) as pdf:
        carried = json.loads(pdf.attachments["calibration.json"].get_file().read_bytes())
    assert carried == json.loads(json.dumps(_result().to_json_dict()))
    assert content == calibration_document(_result(), "set")


def test_what_is_undetermined_and_what_is_extrapolated_is_said() -> None:
    lines = calibration_lines(_result())
    assert any("z_mm" in line and "undetermined" in line for line in lines)
    assert sum("outside what the set covers" in line for line in lines) == 2


def test_all_pictures_are_written(tmp_path) -> None:
    write_pictures(_result(), tmp_path / "pictures")
    names = sorted(p.name for p in (tmp_path / "pictures").iterdir())
    assert names == sorted(f"{name}.png" for name in calibration_figures(_result()))


def test_an_error_of_the_camera_across_is_one_of_the_part() -> None:
    result = _result()
    only_x = np.zeros((13, 13))
    only_x[7, 7] = 1e-6
    sigma = result_sigma(result.sensor, result.camera, only_x)
    # Looking along -z, unturned: a shift of the camera is a shift of the part, and nothing else.
    assert np.abs(sigma[3:6] - [1e-3, 0, 0]).max() < 1e-9
    assert np.abs(sigma[[0, 1, 2, 6]]).max() < 1e-9
