"""Write camera.yaml, with what people ask later: when, from what, how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omm_core.files.declared import write_section
from omm_core.files.output import write_whole
from omm_core.files.sensor import BrownIntrinsics, NamedSensor, PlumbBobIntrinsics, TaperToCamera


def camera_yaml(
    *,
    sensor: NamedSensor,
    values: Mapping[str, float],
    covariance: Sequence[Sequence[float]],
    notes: Mapping[str, Any],
    blocks: Mapping[str, Any] | None = None,
) -> str:
    """Return camera.yaml of a camera with Brown's lens.

    Parameters
    ----------
    sensor : NamedSensor
    values : mapping
        The 13 parameters by name, in the order of the covariance.
    covariance : (13, 13)
        In the units of the names.
    notes : mapping
        What stands under ``calibration``: plain numbers, texts and lists.
    blocks : mapping, optional
        Further blocks of the file (``imaging``, ``body``), which a calibration does not measure.
    """
    import yaml

    content = {
        "camera": write_section(sensor),
        "model": "brown_photogrammetric",
        "intrinsics": write_section(
            BrownIntrinsics(
                focal_length_mm=values["focal_length_mm"],
                principal_point_offset_px=(values["cl0_px"], values["rw0_px"]),
                **{key: values[key] for key in ("k1_px2", "k2_px4", "p1_px", "p2_px")},
            )
        ),
        "taper_to_camera": write_section(
            TaperToCamera(
                translation_mm=tuple(values[key] for key in ("x_mm", "y_mm", "z_mm")),
                euler_xyz_rad=tuple(values[key] for key in ("alpha_rad", "beta_rad", "gamma_rad")),
            )
        ),
        "covariance": {
            "parameters": list(values),
            "matrix": [[float(v) for v in row] for row in covariance],
        },
        **(blocks or {}),
        "calibration": dict(notes),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    return str(text)


def lens_yaml(
    *,
    sensor: NamedSensor,
    intrinsics: PlumbBobIntrinsics,
    source: str,
    largest_error_px: float,
) -> str:
    """Return the lens block of camera.yaml (plumb_bob), and what must be added as comments."""
    import yaml

    content = {
        "camera": write_section(sensor),
        "model": "plumb_bob",
        "intrinsics": write_section(intrinsics),
        "calibration": {"imported_from": source, "largest_error_px": largest_error_px},
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    return (
        f"{text}# Missing: where the camera sits in the tool holder. Replace the question marks:\n"
        "# taper_to_camera:\n#   translation_mm: [?, ?, ?]\n#   euler_xyz_rad: [?, ?, ?]\n"
        "# Missing: the covariance (docs/calibration.md). Without it the lens counts as exact.\n"
    )


def write_camera(path: Path, text: str) -> None:
    """Write camera.yaml whole or not at all."""
    write_whole(path, text)
