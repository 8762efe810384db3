"""Recognise and read camera calibrations of other programs, by what they are.

| program | file | pixel (0, 0) | lens |
|---|---|---|---|
| ROS | ``ost.yaml``, ``ost.ini``, a printed CameraInfo | first pixel's centre | OpenCV's, fisheye |
| OpenCV | FileStorage as YAML, XML, JSON | the same | OpenCV's, fisheye |
| Kalibr | ``camchain.yaml`` | the same | radtan, equi, fov |
| Metashape | calibration XML | corner of the image | OpenCV's radial, P1 and P2 swapped |
| COLMAP | ``cameras.txt`` | corner of the image | OpenCV's, fisheye |
| ORB-SLAM, camodocal | settings as YAML | first pixel's centre | OpenCV's, fisheye |
| anyone's JSON | camera matrix and coefficients by OpenCV's names | the same | OpenCV's |

None of them knows where the camera sits in the tool holder.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.foreign_formats import (
    ForeignCalibration,
    keys_of_opencv_xml,
    keys_of_yaml,
    read_kalibr,
    read_matrices,
    read_metashape,
    read_ost_ini,
)
from omm_core.files.foreign_named import read_camodocal, read_colmap, read_orb_slam
from omm_core.files.outside import Source, read_text

Array = NDArray[np.float64]

_LARGEST_BYTES = 20 << 20
_JSON_KEYS = r'"(camera_?matrix|mtx|K|intrinsic_matrix|M1)"\s*:'
_KINDS = (
    ("ORB-SLAM", r"^Camera1?\.fx\s*:"),
    ("camodocal", r"^model_type\s*:[\s\S]*^projection_parameters\s*:"),
    ("COLMAP (cameras.txt)", r"^\d+ +[A-Z_]+ +\d+ +\d+( +[-+.\deE]+)+\s*$"),
    ("OpenCV (FileStorage)", r"^%YAML|<opencv_storage>|!!opencv-matrix|\"opencv-matrix\""),
    ("Metashape", r"<calibration[\s>][\s\S]*(<projection>|<resolution\s|<f>|<fx>)"),
    ("ROS (ost.ini)", r"^# oST version|^camera matrix\s*$"),
    ("Kalibr", r"^cam\d+\s*:[\s\S]*(camera_model|distortion_model)\s*:"),
    ("ROS (ost.yaml)", r"^camera_matrix\s*:[\s\S]*^distortion_(model|coefficients)\s*:"),
    ("ROS (ost.yaml)", r"^distortion_(model|coefficients)\s*:[\s\S]*^camera_matrix\s*:"),
    ("ROS (CameraInfo)", r"^distortion_model\s*:[\s\S]*^[kK]\s*:"),
    (
        "OpenCV (JSON)",
        r"\A\s*\{(?=[\s\S]*(?i:" + _JSON_KEYS + r"))[\s\S]*\"([dD]|(?i:dist\w*))\"\s*:",
    ),
)


def foreign_source(text: str) -> str | None:
    """Return whose calibration a text is, or None where it is none that is known."""
    return next((name for name, sign in _KINDS if re.search(sign, text, re.MULTILINE)), None)


def refuse_foreign(path: Source) -> None:
    """Raise InputError where a file is another program's calibration: say whose, and what to do."""
    try:
        source = foreign_source(read_text(path, "calibration", _LARGEST_BYTES))
    except InputError:
        return  # the reader of camera.yaml tells what is wrong with it
    if source is not None:
        raise InputError(
            f"{path} is a calibration of {source}: it holds a lens, but not where the camera sits"
            f" in the tool holder (taper_to_camera). './omm calibrate --import {path} --out"
            " camera.yaml' takes the lens and says what is missing; docs/calibration.md shows"
            " camera.yaml."
        )


def read_foreign(path: str | Path) -> ForeignCalibration:
    """Read a calibration of another program.

    Raises
    ------
    InputError
        Where the file is none of these, is malformed, or its lens is of an unknown kind.
    """
    path = Path(path)
    text = read_text(path, "calibration", _LARGEST_BYTES)
    source = foreign_source(text)
    if source is None:
        raise InputError(
            f"{path}: expected a calibration of ROS (ost.yaml, ost.ini), OpenCV (FileStorage),"
            " Kalibr (camchain.yaml), Metashape (XML), COLMAP (cameras.txt), ORB-SLAM, camodocal or"
            " JSON with a camera matrix and distortion coefficients, got a file that is none of"
            " them."
        )
    try:
        if source == "Metashape":
            return read_metashape(text)
        if source == "ROS (ost.ini)":
            return read_ost_ini(text)
        if source == "ROS (CameraInfo)":
            text = re.split(r"^---", text, flags=re.MULTILINE)[0]  # ros2 topic echo ends so
        if source == "COLMAP (cameras.txt)":
            return read_colmap(text)
        values = keys_of_opencv_xml(text) if "<opencv_storage>" in text else keys_of_yaml(text)
        by_keys = {
            "Kalibr": read_kalibr, "ORB-SLAM": read_orb_slam, "camodocal": read_camodocal
        }  # fmt: skip
        return by_keys[source](values) if source in by_keys else read_matrices(source, values)
    except InputError as error:
        raise InputError(f"{path}, a calibration of {source}: {error}") from None
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        words = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}, a calibration of {source}, is malformed: {words}.") from None
