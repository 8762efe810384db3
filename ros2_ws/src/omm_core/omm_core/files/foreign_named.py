"""Calibrations that name each number: COLMAP's cameras.txt, ORB-SLAM's settings, camodocal's."""

from __future__ import annotations

from typing import Any

from omm_core.errors import InputError
from omm_core.files.foreign_formats import ForeignCalibration, make_foreign
from omm_core.files.foreign_numbers import image_size, number

_COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
_PLAIN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")


def read_colmap(text: str) -> ForeignCalibration:
    """Read the first camera of COLMAP's cameras.txt, whose pixels begin at the image's corner."""
    rows = [line.split() for line in text.splitlines() if line.strip() and line[0] != "#"]
    name, model, width, height, *values = rows[0]
    if model not in _COLMAP:
        raise InputError(f"expected a camera model of {', '.join(_COLMAP)}, got {model}.")
    names = _COLMAP[model].split()
    if len(values) != len(names):
        raise InputError(f"expected {len(names)} numbers of the model {model}, got {len(values)}.")
    value = dict(zip(names, map(number, values)))
    value["cx"] -= 0.5
    value["cy"] -= 0.5
    others = f"camera {name} is taken, not {', '.join(row[0] for row in rows[1:])}"
    return _of_names(
        "COLMAP",
        f"camera {name}",
        (int(number(width)), int(number(height))),
        value,
        fisheye="FISHEYE" in model,
        findings=(others,) if len(rows) > 1 else (),
    )


def read_orb_slam(values: dict[str, Any]) -> ForeignCalibration:
    """Read the (left) camera of ORB-SLAM's settings."""
    prefix = "Camera1." if "Camera1.fx" in values else "Camera."
    kind = str(values.get("Camera.type", "PinHole"))
    if kind not in ("PinHole", "KannalaBrandt8"):
        raise InputError(f"expected the Camera.type PinHole or KannalaBrandt8, got '{kind}'.")
    value = {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)}
    return _of_names(
        "ORB-SLAM", "camera", image_size(values), value, fisheye=kind == "KannalaBrandt8"
    )


def read_camodocal(values: dict[str, Any]) -> ForeignCalibration:
    """Read camodocal's PINHOLE or KANNALA_BRANDT."""
    kind = str(values["model_type"])
    if kind not in ("PINHOLE", "KANNALA_BRANDT"):
        raise InputError(f"expected the model_type PINHOLE or KANNALA_BRANDT, got '{kind}'.")
    value = {**values.get("distortion_parameters", {}), **values["projection_parameters"]}
    fisheye = kind == "KANNALA_BRANDT"
    if fisheye:  # its radial terms begin with k2, of the third power
        names = {"mu": "fx", "mv": "fy", "u0": "cx", "v0": "cy",
                 "k2": "k1", "k3": "k2", "k4": "k3", "k5": "k4"}  # fmt: skip
        value = {names.get(key, key): v for key, v in value.items()}
    name = str(values.get("camera_name", ""))
    return _of_names("camodocal", name, image_size(values), value, fisheye=fisheye)


def _of_names(
    source: str,
    name: str,
    size: tuple[int, int],
    value: dict[str, Any],
    *,
    fisheye: bool,
    findings: tuple[str, ...] = (),
) -> ForeignCalibration:
    fx, fy = (number(value["f"] if "f" in value else value[key]) for key in ("fx", "fy"))
    cx, cy = number(value["cx"]), number(value["cy"])
    terms = _FISHEYE if fisheye else _PLAIN
    return make_foreign(
        source=source,
        name=name,
        size=size,
        matrix=[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        model="equidistant" if fisheye else "opencv",
        coefficients=[number(value.get(term, 0.0)) for term in terms],
        findings=findings,
    )
