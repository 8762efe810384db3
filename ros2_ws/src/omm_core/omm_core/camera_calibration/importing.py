"""Take the lens of another program's calibration as omm's plumb_bob, and how well that went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.foreign_formats import ForeignCalibration
from omm_core.imaging.lens import PlumbBob, check_lens

Array = NDArray[np.float64]

# A conversion worse than this is of the size of what the detector measures.
NOTICEABLE_PX = 0.02
_STEP = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedLens:
    """A lens, how far from the original it is at most over the image, and what to know."""

    lens: PlumbBob
    largest_error_px: float
    findings: tuple[str, ...]


def import_lens(foreign: ForeignCalibration) -> ImportedLens:
    """Return the plumb_bob lens nearest to another program's.

    The same numbers where the models are the same; else least squares on the rays of a grid of
    pixels that covers the image to its edges.

    Raises
    ------
    InputError
        Where the lens does not see each pixel in one direction.
    """
    fx, fy, cx, cy = foreign.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
    lens = PlumbBob(
        width_px=foreign.width_px, height_px=foreign.height_px,
        fx_px=float(fx), fy_px=float(fy), cx_px=float(cx), cy_px=float(cy),
    )  # fmt: skip
    same = (
        foreign.model == "opencv"
        and not any(foreign.coefficients[5:])
        and foreign.radial_8 == 0.0
        and not any(foreign.tangential_r)
        and foreign.matrix[0, 1] == 0.0
    )
    pixels = lens.pixel_grid(61)
    rays = _rays(foreign, pixels)
    vector = np.array([fx, fy, cx, cy, *foreign.coefficients[:5]])
    if not same:
        vector = _fit(lens, vector, rays, pixels)
    lens = _lens(lens, vector)
    check_lens(lens)
    error = np.hypot(*(lens.pixels_from_normalised(rays)[0] - pixels).T)
    if not np.isfinite(error).all():
        raise InputError("Expected a lens that plumb_bob can describe over the whole image.")
    largest = 0.0 if same else float(error.max())  # the same formula: what is left is rounding
    return ImportedLens(
        lens=lens, largest_error_px=largest, findings=_findings(foreign, same, largest)
    )


def _findings(foreign: ForeignCalibration, same: bool, largest: float) -> tuple[str, ...]:
    found = list(foreign.findings)
    if not same:
        words = f"the lens model is another; plumb_bob follows it to {largest:.3g} px at most"
        if largest > NOTICEABLE_PX:
            words += ": more than the detector's error, so calibrate with './omm calibrate SET'"
        found.append(words)
    found += [
        "missing: taper_to_camera, where the camera sits in the tool holder (translation_mm,"
        " euler_xyz_rad); './omm calibrate SET' finds it together with the lens",
        "missing: the covariance; without it the lens would count as exact",
    ]
    return tuple(found)


def foreign_pixels(foreign: ForeignCalibration, rays: Array) -> Array:
    """Return where (x/z, y/z) (N, 2) appear, by the other program's own formulas."""
    x, y = rays.T
    r2 = x * x + y * y
    c = foreign.coefficients
    if foreign.model == "opencv":
        over = 1 + r2 * (c[0] + r2 * (c[1] + r2 * (c[4] + r2 * foreign.radial_8)))
        scale = over / (1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])))
        more = 1 + r2 * (foreign.tangential_r[0] + r2 * foreign.tangential_r[1])
        xd = x * scale + more * (2 * c[2] * x * y + c[3] * (r2 + 2 * x * x))
        yd = y * scale + more * (c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y)
        xd, yd = xd + r2 * (c[8] + r2 * c[9]), yd + r2 * (c[10] + r2 * c[11])
    else:
        r = np.maximum(np.sqrt(r2), 1e-12)
        if foreign.model == "fov":
            w = c[0]
            bent = np.arctan(2 * r * np.tan(w / 2)) / w if w else r
        else:
            theta = np.arctan(r)
            t2 = theta**2
            bent = theta * (1 + t2 * (c[0] + t2 * (c[1] + t2 * (c[2] + t2 * c[3]))))
        xd, yd = x * bent / r, y * bent / r
    distorted = np.column_stack([xd, yd, np.ones_like(xd)])
    return np.asarray((distorted @ foreign.matrix.T)[:, :2])


def _rays(foreign: ForeignCalibration, pixels: Array) -> Array:
    """Invert by Newton's method from the undistorted ray."""
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    rays = (homogeneous @ np.linalg.inv(foreign.matrix).T)[:, :2]
    with np.errstate(all="ignore"):
        for _ in range(50):
            left = pixels - foreign_pixels(foreign, rays)
            by_x = foreign_pixels(foreign, rays + [_STEP, 0]) - foreign_pixels(
                foreign, rays - [_STEP, 0]
            )
            by_y = foreign_pixels(foreign, rays + [0, _STEP]) - foreign_pixels(
                foreign, rays - [0, _STEP]
            )
            jacobian = np.stack([by_x, by_y], axis=-1) / (2 * _STEP)
            if not np.isfinite(jacobian).all() or np.any(np.linalg.det(jacobian) <= 0):
                break
            rays = rays + np.linalg.solve(jacobian, left[..., None])[..., 0]
        left = np.abs(pixels - foreign_pixels(foreign, rays))
    if not np.all(left < 1e-6):
        raise InputError(
            "Expected a lens that sees every pixel of its image in one direction only, got one"
            " that folds back on itself. Check the size of the image and the coefficients."
        )
    return rays


def _lens(lens: PlumbBob, vector: Array) -> PlumbBob:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(v) for v in vector)
    return PlumbBob(
        width_px=lens.width_px, height_px=lens.height_px, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy,
        k1=k1, k2=k2, p1=p1, p2=p2, k3=k3,
    )  # fmt: skip


def _fit(lens: PlumbBob, start: Array, rays: Array, pixels: Array) -> Array:
    """Fit the nine numbers by Gauss-Newton; bilinear, so a few steps are enough."""
    x, y = rays.T
    r2, zero, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    vector = np.array([*start[:4], 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(30):
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = vector
        scale = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        radial = [r2, r2**2]
        col = [xd, zero, one, zero, *(fx * x * p for p in radial), fx * 2 * x * y,
               fx * (r2 + 2 * x * x), fx * x * r2**3]  # fmt: skip
        row = [zero, yd, zero, one, *(fy * y * p for p in radial), fy * (r2 + 2 * y * y),
               fy * 2 * x * y, fy * y * r2**3]  # fmt: skip
        design = np.vstack([np.column_stack(col), np.column_stack(row)])
        left = pixels - np.column_stack([fx * xd + cx, fy * yd + cy])
        size = np.abs(design).max(axis=0)
        change = np.linalg.lstsq(design / size, left.T.ravel(), rcond=None)[0] / size
        vector = vector + change
        if np.abs(design @ change).max() < 1e-10:
            break
    return vector
