"""The calibration files of ROS, OpenCV, Kalibr and Metashape, each read by its own rules."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.foreign_numbers import image_size, matrix, number, numbers, off_middle
from omm_core.files.strict_yaml import parse_yaml

Array = NDArray[np.float64]


_MATRICES = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "intrinsic_matrix",
             "mtx", "k", "K", "M1")  # fmt: skip
_DISTORTIONS = (
    *("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "DistCoeffs"),
    *("dist_coeffs", "dist_coeff", "distortion_coeffs", "dist", "d", "D", "D1"),
)
_TILT_TERMS = 12  # OpenCV's coefficients 13 and 14 tilt the sensor


@dataclass(frozen=True, kw_only=True, eq=False)
class ForeignCalibration:
    """A lens as another program wrote it, in omm's pixels.

    Attributes
    ----------
    source, name : str
        The program; the camera, for people.
    width_px, height_px : int
    matrix : (3, 3) array
        From distorted normalised coordinates to pixels; (0, 0) is the first pixel's centre.
    model : str
        ``opencv``, ``equidistant`` (OpenCV's fisheye) or ``fov``.
    coefficients : tuple of float
        In OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; k1..k4 of the fisheye; w of fov.
    radial_8 : float
        Metashape's fourth radial coefficient, of r⁸.
    tangential_r : tuple of float
        Metashape's P3 and P4: its tangential terms times 1 + P3 r² + P4 r⁴.
    """

    source: str
    name: str
    width_px: int
    height_px: int
    matrix: Array
    model: str
    coefficients: tuple[float, ...]
    radial_8: float = 0.0
    tangential_r: tuple[float, float] = (0.0, 0.0)
    findings: tuple[str, ...] = field(default=())


def keys_of_yaml(text: str) -> dict[str, Any]:
    """Return what an OpenCV or ROS YAML says, by key."""
    text = re.sub(r"^%YAML[^\n]*\n", "", text.lstrip("\ufeff"))
    loaded = parse_yaml(re.sub(r"!!opencv-(nd-)?matrix", "", text), "the calibration")
    if not isinstance(loaded, dict):
        raise InputError("expected keys with values.")
    return loaded


def keys_of_opencv_xml(text: str) -> dict[str, Any]:
    """Return what an OpenCV XML says, by key."""
    root = _xml(text)
    return {
        child.tag: {"data": (child.findtext("data") or "").split()}
        if child.find("data") is not None
        else (child.text or "").strip()
        for child in root
    }


def _xml(text: str) -> Any:
    from xml.etree import ElementTree

    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("expected plain XML, got one with a document type.")
    try:
        return ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        raise InputError(f"it is not XML: {error}.") from None


def read_metashape(text: str) -> ForeignCalibration:
    """Read Metashape's XML of one camera."""
    root = _xml(text)
    if root.tag != "calibration":
        raise InputError(
            "expected the calibration of one camera, got a document of cameras. Save it by"
            " Tools > Camera Calibration > Adjusted."
        )
    if root.find("fx") is not None:
        raise InputError(
            "expected one focal length f, got fx and fy as PhotoScan before 1.2 wrote them: open it"
            " in Metashape and save it again."
        )
    missing = [name for name in ("width", "height", "f") if root.find(name) is None]
    if missing:
        raise KeyError(missing[0])
    projection = (root.findtext("projection") or "frame").strip()
    if projection != "frame":
        raise InputError(f"expected the projection 'frame', got '{projection}'.")
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    value = {name: number(root.findtext(name) or 0.0) for name in names}
    width, height = image_size({name: root.findtext(name) for name in ("width", "height")})
    # Metashape's pixel (0, 0) is the image's corner, and cx, cy are from the image's middle.
    col, row = (width - 1) / 2 + value["cx"], (height - 1) / 2 + value["cy"]
    return make_foreign(
        source="Metashape",
        name="",
        size=(width, height),
        matrix=[[value["f"] + value["b1"], value["b2"], col], [0.0, value["f"], row], [0, 0, 1]],
        model="opencv",
        coefficients=[value[name] for name in ("k1", "k2", "p2", "p1", "k3")],
        radial_8=value["k4"],
        tangential_r=(value["p3"], value["p4"]),
    )


def read_ost_ini(text: str) -> ForeignCalibration:
    """Read ROS's ost.ini."""

    def block(name: str, lines: int) -> list[float]:
        found = re.search(rf"^{name}\s*\n((?:[^\n]*\n?){{{lines}}})", text, re.MULTILINE)
        if found is None:
            raise KeyError(name)
        return numbers(found.group(1))

    sections = [s for s in re.findall(r"^\[(.+)\]", text, re.MULTILINE) if s != "image"]
    distortion = block("distortion", 1)
    _refuse_unnamed(distortion)
    return make_foreign(
        source="ROS (ost.ini)",
        name=sections[0] if sections else "",
        size=(int(block("width", 1)[0]), int(block("height", 1)[0])),
        matrix=matrix(block("camera matrix", 3)),
        model="opencv",
        coefficients=distortion,
    )


def read_matrices(source: str, values: dict[str, Any]) -> ForeignCalibration:
    """Read what ROS and OpenCV write."""
    camera = _first(values, _MATRICES)
    distortion = numbers(_first(values, _DISTORTIONS))
    size = image_size(values)
    if "xi" in values:
        raise InputError("expected a camera with a plain lens, got an omnidirectional one (xi).")
    _refuse_part_of_image(values)
    told = str(values.get("distortion_model", "plumb_bob"))
    if not {"distortion_model", "fisheye_model"} & values.keys():
        _refuse_unnamed(distortion)
    fisheye = told in ("equidistant", "fisheye") or bool(number(values.get("fisheye_model", 0)))
    if not fisheye and told not in ("plumb_bob", "rational_polynomial"):
        raise InputError(
            "expected the distortion_model plumb_bob, rational_polynomial or equidistant,"
            f" got '{told}'."
        )
    return make_foreign(
        source=source,
        name=str(values.get("camera_name", "")),
        size=size,
        matrix=matrix(camera),
        model="equidistant" if fisheye else "opencv",
        coefficients=distortion,
        findings=("M1 and D1 are taken, not M2 and D2",) if "M2" in values else (),
    )


def _refuse_unnamed(coefficients: list[float]) -> None:
    if len(coefficients) == 4 and any(coefficients):
        raise InputError(
            "expected the name of the lens model, as OpenCV's fisheye has 4 coefficients and its"
            " plain lens may. Add 'distortion_model: equidistant' or 'distortion_model: plumb_bob'"
            " to the YAML file."
        )


def _refuse_part_of_image(values: dict[str, Any]) -> None:
    """Refuse a CameraInfo whose matrix is not that of the images which came with it."""
    roi = values.get("roi") or {}
    size = [(int(roi.get(name, 0)), int(values[name])) for name in ("width", "height") if roi]
    binning = [int(values.get(name, 0)) for name in ("binning_x", "binning_y")]
    if max(binning) > 1 or any(part not in (0, whole) for part, whole in size):
        raise InputError(
            "expected the camera to send its whole image without binning, got one with a binning"
            " or roi: its matrix is not that of the images."
        )


def _first(values: dict[str, Any], names: tuple[str, ...]) -> Any:
    for name in names:
        if name in values:
            return values[name]
    raise KeyError(names[0])


def read_kalibr(values: dict[str, Any]) -> ForeignCalibration:
    """Read the first camera of Kalibr's camchain."""
    names = sorted(name for name in values if re.fullmatch(r"cam\d+", name))
    cam = values[names[0]]
    if cam.get("camera_model", "pinhole") != "pinhole":
        raise InputError(f"expected the camera_model pinhole, got '{cam['camera_model']}'.")
    models = {"radtan": "opencv", "equidistant": "equidistant", "equi": "equidistant", "fov": "fov"}
    if "distortion_model" not in cam and cam.get("distortion_coeffs"):
        raise KeyError("distortion_model")
    told = str(cam.get("distortion_model", "none"))
    if told not in (*models, "none"):
        raise InputError(f"expected the distortion_model radtan, equi or fov, got '{told}'.")
    if len(cam["intrinsics"]) != 4:
        raise InputError(f"expected 4 intrinsics of a pinhole, got {len(cam['intrinsics'])}.")
    fx, fy, cx, cy = numbers(cam["intrinsics"])
    others = f"{names[0]} is taken, not {', '.join(names[1:])}" if len(names) > 1 else ""
    return make_foreign(
        source="Kalibr",
        name=names[0],
        size=image_size(cam),
        matrix=[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        model=models.get(told, "opencv"),
        coefficients=cam.get("distortion_coeffs", []) if told != "none" else [],
        findings=(others,) if others else (),
    )


def make_foreign(
    *,
    source: str,
    name: str,
    size: tuple[int, int],
    matrix: Any,
    model: str,
    coefficients: Any,
    radial_8: float = 0.0,
    tangential_r: tuple[float, float] = (0.0, 0.0),
    findings: tuple[str, ...] = (),
) -> ForeignCalibration:
    """Return a lens whose numbers were looked at.

    Raises
    ------
    InputError
        Where they are those of no lens, or of one that is not understood.
    """
    matrix = np.array(matrix, dtype=float)
    values = [number(v) for v in coefficients]
    if min(size) < 1:
        raise InputError(f"expected the image's size, got {size[0]} x {size[1]} pixels.")
    if not (np.isfinite(matrix).all() and np.isfinite([*values, radial_8, *tangential_r]).all()):
        raise InputError("expected finite numbers in the camera matrix and the distortion.")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise InputError("expected focal lengths above zero (is the camera calibrated?).")
    if model == "opencv":
        if len(values) not in (0, 4, 5, 8, 12, 14):
            raise InputError(f"expected 0, 4, 5, 8, 12 or 14 coefficients, got {len(values)}.")
        if any(values[_TILT_TERMS:]):
            raise InputError("expected a sensor that is not tilted (coefficients 13 and 14 0).")
        values = (values + [0.0] * 12)[:12]
    else:
        known = 1 if model == "fov" else 4
        if any(values[known:]):
            raise InputError(
                f"expected {known} coefficients of the model {model}, got {len(values)}."
            )
        values = (values + [0.0] * 4)[:4]
    return ForeignCalibration(
        source=source,
        name=name or "camera",
        width_px=size[0],
        height_px=size[1],
        matrix=matrix / matrix[2, 2],
        model=model,
        coefficients=tuple(values),
        radial_8=radial_8,
        tangential_r=tangential_r,
        findings=(*findings, *off_middle(matrix / matrix[2, 2], size)),
    )
