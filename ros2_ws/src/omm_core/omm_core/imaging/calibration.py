"""A calibrated camera: lens, sensor, where it sits in the tool holder, and how well known.

``load_calibration`` reads ``camera.yaml`` (contract.md, "Files"). The calibration is seen as one
vector of named parameters, so that its covariance can be propagated (docs/statistics.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.files.declared import read_optional, read_section
from omm_core.files.foreign_calibration import refuse_foreign
from omm_core.files.outside import Source
from omm_core.files.sensor import (
    BrownIntrinsics,
    NamedSensor,
    PlumbBobIntrinsics,
    TaperToCamera,
)
from omm_core.files.yaml_input import YamlSection, read_yaml
from omm_core.geometry import RigidTransform
from omm_core.imaging.lens import BrownPhotogrammetric, Lens, PlumbBob, check_lens
from omm_core.imaging.taking import Body, Imaging
from omm_core.words import keyed, verbatim

Array = NDArray[np.float64]

_INTRINSICS: dict[type, tuple[str, ...]] = {
    BrownPhotogrammetric: (
        "focal_length_mm", "cl0_px", "rw0_px", "k1_px2", "k2_px4", "p1_px", "p2_px",
    ),
    PlumbBob: ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"),
}  # fmt: skip
_EXTRINSICS = ("x_mm", "y_mm", "z_mm", "alpha_rad", "beta_rad", "gamma_rad")
_FILE_KEYS = (
    "camera", "model", "intrinsics", "taper_to_camera", "covariance", "parameters", "calibration",
    "imaging", "body",
)  # fmt: skip
# Of other lens models, under the names that they have there.
_FURTHER_TERMS = frozenset({
    "k3", "k4", "k5", "k6", "k3_px6", "k4_px8", "p3", "p4", "s1", "s2", "s3", "s4", "b1", "b2",
    "xi", "tau_x", "tau_y",
})  # fmt: skip
# Other ways in which calibration files name the same parameters.
_ALIASES = {
    "principal_point_offset_px[0]": "cl0_px",
    "principal_point_offset_px[1]": "rw0_px",
    "principal_point_offset_px_0": "cl0_px",
    "principal_point_offset_px_1": "rw0_px",
    **{f"translation_mm[{i}]": _EXTRINSICS[i] for i in range(3)},
    **{f"translation_mm_{i}": _EXTRINSICS[i] for i in range(3)},
    **{f"euler_xyz_rad[{i}]": _EXTRINSICS[3 + i] for i in range(3)},
    **{f"euler_xyz_rad_{i}": _EXTRINSICS[3 + i] for i in range(3)},
}


@dataclass(frozen=True, kw_only=True)
class Covered:
    """Where the dots of a calibration's set were: outside, a calibration is extrapolated.

    Attributes
    ----------
    distance_mm : tuple of two
        Nearest and farthest, along the optical axis.
    low_px, high_px : tuple of two
        Corners (col, row) of the box of the image.
    """

    distance_mm: tuple[float, float]
    low_px: tuple[float, float]
    high_px: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraCalibration:
    """What is known about a camera in its tool holder.

    Attributes
    ----------
    name : str
        The camera, for people.
    lens : Lens
        :class:`BrownPhotogrammetric` or :class:`PlumbBob`.
    taper_T_camera : RigidTransform
        (R_calib, d_calib) of eq. 21.
    pixel_size_mm : float or None
        Where the file tells it.
    parameters : tuple of str
        Which parameters ``covariance`` is about, in its order; a subset of
        :meth:`parameter_names`. Empty: the calibration is taken as exact.
    covariance : (P, P) array
        Of those parameters, in the units of their names.
    imaging : Imaging
        Exposure, focus and tilt, where the file tells them.
    body : Body or None
        The housing; None where the file does not tell it: the camera's own point.
    covered : Covered or None
        Where the calibration is known to hold; None where the file does not tell it.
    """

    name: str
    lens: Lens
    taper_T_camera: RigidTransform
    pixel_size_mm: float | None = None
    parameters: tuple[str, ...] = ()
    covariance: Array
    imaging: Imaging = field(default_factory=Imaging)
    body: Body | None = None
    covered: Covered | None = None

    @property
    def width_px(self) -> int:
        """Width of the sensor."""
        return self.lens.width_px

    @property
    def height_px(self) -> int:
        """Height of the sensor."""
        return self.lens.height_px

    def check_image_shape(self, shape: tuple[int, ...]) -> None:
        """Raise InputError where an image (H, W) is not of this calibration's sensor."""
        if tuple(shape) != (self.height_px, self.width_px):
            got = " x ".join(str(n) for n in reversed(shape))
            raise InputError(
                keyed(
                    "said.other_size",
                    "Expected images of {wanted} pixels, for which '{camera}' is calibrated, got"
                    " {got}. Use the calibration of this camera, and no region of interest or"
                    " binning.",
                    wanted=f"{self.width_px} x {self.height_px}",
                    camera=verbatim(self.name),
                    got=got,
                )
            )

    def parameter_names(self) -> tuple[str, ...]:
        """Return the names of all parameters: those of the lens, then x, y, z, Euler angles."""
        return _INTRINSICS[type(self.lens)] + _EXTRINSICS

    def parameter_values(self, names: tuple[str, ...]) -> Array:
        """Return the values of parameters by name."""
        pose = dict(zip(_EXTRINSICS, self._pose_vector(), strict=True))
        return np.array([pose[n] if n in pose else getattr(self.lens, n) for n in names])

    def with_parameters(self, names: tuple[str, ...], values: ArrayLike) -> CameraCalibration:
        """Return the same calibration with other values for some parameters."""
        given = dict(zip(names, (float(v) for v in np.asarray(values)), strict=True))
        old = dict(zip(_EXTRINSICS, self._pose_vector(), strict=True))
        x, y, z, alpha, beta, gamma = (given.pop(name, old[name]) for name in _EXTRINSICS)
        pose = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, (x, y, z))
        lens = replace(self.lens, **given)  # type: ignore[arg-type]
        return replace(self, lens=lens, taper_T_camera=pose)

    def _pose_vector(self) -> list[float]:
        return [*self.taper_T_camera.translation_mm, *self.taper_T_camera.euler_xyz_rad()]


def load_calibration(path: Source) -> CameraCalibration:
    """Read ``camera.yaml``.

    Raises
    ------
    InputError
        Where the file is missing, malformed, names an unknown model, or its lens cannot be.
    """
    refuse_foreign(path)
    root = read_yaml(path, "calibration file")
    root.check_keys(*_FILE_KEYS)
    sensor = read_section(NamedSensor, root.section("camera"))
    lens = _lens(root, sensor)
    try:
        check_lens(lens)
    except InputError as error:
        raise InputError(f"{root.where}: intrinsics: {error}") from None
    taper = read_section(TaperToCamera, root.section("taper_to_camera"))
    alpha, beta, gamma = taper.euler_xyz_rad
    pose = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, taper.translation_mm)
    calibration = CameraCalibration(
        name=sensor.name,
        lens=lens,
        taper_T_camera=pose,
        pixel_size_mm=sensor.pixel_size_mm,
        covariance=np.zeros((0, 0)),
        imaging=read_optional(Imaging, root, "imaging") or Imaging(),
        body=read_optional(Body, root, "body"),
        covered=_covered(root),
    )
    if "covariance" not in root:
        return calibration
    parameters, covariance = _covariance(root, calibration.parameter_names())
    return replace(calibration, parameters=parameters, covariance=covariance)


def _covered(root: YamlSection) -> Covered | None:
    """Read what ``./omm calibrate`` wrote of its set; other programs' notes are theirs."""
    notes = root.get("calibration") if "calibration" in root else None
    if not isinstance(notes, dict) or not {"distance_mm", "image_px"} <= set(notes):
        return None
    section = root.section("calibration")
    near, far = section.numbers("distance_mm", 2)
    corners = section.get("image_px")
    if not isinstance(corners, list) or len(corners) != 2:
        raise InputError(f"{section.where}: expected image_px as [[col, row], [col, row]].")
    where = YamlSection({f"corner {i}": c for i, c in enumerate(corners)}, section.where)
    low, high = (where.numbers(f"corner {i}", 2) for i in range(2))
    return Covered(
        distance_mm=(float(near), float(far)),
        low_px=(float(low[0]), float(low[1])),
        high_px=(float(high[0]), float(high[1])),
    )


def _refuse_further_terms(section: YamlSection, known: Collection[str]) -> None:
    """Raise InputError for a lens with a term that the model lacks: it is another lens."""
    for key in sorted(_FURTHER_TERMS.intersection(section.values) - set(known)):
        if section.values[key] not in (0, None):
            raise InputError(
                f"{section.where}: expected the terms {', '.join(known)}, got"
                f" {key}: {section.values[key]}. A lens with that term is of a model that omm does"
                " not have; './omm calibrate SET' calibrates the camera in one that it has."
            )


def _lens(root: YamlSection, sensor: NamedSensor) -> Lens:
    model, section = root.text("model"), root.section("intrinsics")
    width, height = sensor.width_px, sensor.height_px
    if model == "brown_photogrammetric":
        _refuse_further_terms(section, [term.name for term in dataclasses.fields(BrownIntrinsics)])
        told = dataclasses.asdict(read_section(BrownIntrinsics, section))
        cl0, rw0 = told.pop("principal_point_offset_px")
        return BrownPhotogrammetric(
            width_px=width,
            height_px=height,
            pixel_size_mm=root.section("camera").number("pixel_size_mm"),
            cl0_px=cl0,
            rw0_px=rw0,
            **told,
        )
    if model == "plumb_bob":
        _refuse_further_terms(
            section, [term.name for term in dataclasses.fields(PlumbBobIntrinsics)]
        )
        told = dataclasses.asdict(read_section(PlumbBobIntrinsics, section))
        return PlumbBob(width_px=width, height_px=height, **told)
    raise InputError(
        f"{root.where}: expected the model 'brown_photogrammetric' or 'plumb_bob', got '{model}'."
    )


def _covariance(root: YamlSection, known: tuple[str, ...]) -> tuple[tuple[str, ...], Array]:
    """Read ``covariance: {parameters: [...], matrix: [[...]]}`` or the two side by side."""
    nested = isinstance(root.get("covariance"), dict)
    section = root.section("covariance") if nested else root
    names = section.get("parameters")
    rows = section.get("matrix") if nested else section.get("covariance")
    if not isinstance(names, list) or not isinstance(rows, list) or len(rows) != len(names):
        raise InputError(
            f"{section.where}: expected a covariance with one row for each of its 'parameters'."
        )
    parameters = tuple(_ALIASES.get(str(name), str(name)) for name in names)
    unknown = [name for name in parameters if name not in known]
    if unknown or len(set(parameters)) != len(parameters):
        raise InputError(
            f"{section.where}: expected each of 'parameters' once, from {', '.join(known)};"
            f" got {', '.join(str(name) for name in names)}."
        )
    where = YamlSection({f"row {i}": row for i, row in enumerate(rows)}, section.where)
    matrix = np.array([where.numbers(f"row {i}", len(names)) for i in range(len(names))])
    sigma = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.outer(sigma, sigma)
    if np.any(np.abs(matrix - matrix.T) > 1e-6 * scale) or (
        np.linalg.eigvalsh(matrix / np.where(scale > 0, scale, 1.0)).min() < -1e-6
    ):
        raise InputError(
            f"{section.where}: expected a covariance matrix (symmetric, no negative variance)."
        )
    return parameters, (matrix + matrix.T) / 2
