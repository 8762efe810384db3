"""The two lens models of the contract: where a point in front of the camera appears.

Pixels are (col, row); (0, 0) is the centre of the top-left pixel. Rays and points are in
``camera_optical`` (x right, y down, z forward). Both classes have the same methods, so that
callers never ask which one they hold:

=========================  ====================================================================
``project``                points (N, 3) -> pixels (N, 2); NaN where the lens cannot see a point
``project_with_jacobian``  the same with d(pixel)/d(point), (N, 2, 3)
``rays``                   pixels (N, 2) -> directions (N, 3) with z = 1
=========================  ====================================================================

Brown's model is closed in the direction measured -> ideal, plumb_bob in the direction
ideal -> distorted; the other direction of each is Newton's method on the same two equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.errors import InputError
from omm_core.imaging.distortion import brown_polynomial, inverse_2x2, inverted

Array = NDArray[np.float64]
AnyLens = TypeVar("AnyLens", bound="Lens")


class LensNumbers(NamedTuple):
    """A lens as the compiled kernels read it (kernels.py).

    Attributes
    ----------
    plumb_bob : float
        1 where k and p are of ideal, normalised coordinates; 0 where of measured ones in px.
    fx, fy, col, row : float
        Focal lengths and principal point, px.
    k1, k2, k3, p1, p2 : float
        p1 and p2 in Brown's order for both.
    """

    plumb_bob: float
    fx: float
    fy: float
    col: float
    row: float
    k1: float
    k2: float
    k3: float
    p1: float
    p2: float


@dataclass(frozen=True, kw_only=True)
class Lens(ABC):
    """What both models share: the size of the image, and the chain of points and pixels."""

    width_px: int
    height_px: int

    @abstractmethod
    def normalised_from_pixels(self, pixels: Array) -> Array:
        """Return (x/z, y/z) of the rays of pixels, (N, 2) -> (N, 2)."""

    @abstractmethod
    def pixels_from_normalised(self, normalised: Array) -> tuple[Array, Array]:
        """Return pixels (N, 2) of (x/z, y/z), and d(pixel)/d(normalised), (N, 2, 2)."""

    @abstractmethod
    def numbers(self) -> LensNumbers:
        """Return the numbers of either model by name."""

    def kernel_parameters(self) -> Array:
        """Return the numbers as the compiled kernels take them, (10,).

        One array is handed over faster than ten numbers.
        """
        return np.array(self.numbers())

    def project(self, p_in_camera: ArrayLike) -> Array:
        """Return where points appear.

        Parameters
        ----------
        p_in_camera : (N, 3) array
            Points in ``camera_optical``, mm.

        Returns
        -------
        (N, 2) array
            (col, row) in pixels; NaN for points behind the camera or beyond the angle at which
            the lens model folds back.
        """
        return self.project_with_jacobian(p_in_camera)[0]

    def project_with_jacobian(self, p_in_camera: ArrayLike) -> tuple[Array, Array]:
        """Return pixels (N, 2) and their derivative by the point (N, 2, 3) in px/mm.

        The derivative of the pinhole is eq. 16 of the paper in its right form,
        ``[[1/w, 0, -u/w²], [0, 1/w, -v/w²]]``, multiplied by that of the lens.
        """
        p = _points(p_in_camera, 3, "p_in_camera")
        in_front = p[:, 2] > 0.0
        w = np.where(in_front, p[:, 2], np.nan)
        normalised = p[:, :2] / w[:, None]
        pixels, lens_jacobian = self.pixels_from_normalised(normalised)
        pinhole = np.zeros((len(p), 2, 3))
        pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / w
        pinhole[:, :, 2] = -normalised / w[:, None]
        return pixels, lens_jacobian @ pinhole

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the directions (N, 3), z = 1, in which pixels (N, 2) look."""
        normalised = self.normalised_from_pixels(_points(pixels, 2, "pixels"))
        return np.column_stack([normalised, np.ones(len(normalised))])

    def pixel_grid(self, steps: int = 25) -> Array:
        """Return pixels that cover the image evenly to its outermost edges, (steps², 2)."""
        col = np.linspace(-0.5, self.width_px - 0.5, steps)
        row = np.linspace(-0.5, self.height_px - 0.5, steps)
        return np.stack(np.meshgrid(col, row), axis=-1).reshape(-1, 2)

    def largest_difference_px(self, other: Lens, steps: int = 61) -> float:
        """Return how far apart two lenses see the same ray, at most, over this one's image."""
        pixels = self.pixel_grid(steps)
        difference = other.project(self.rays(pixels)) - pixels
        return float(np.hypot(difference[:, 0], difference[:, 1]).max())


@dataclass(frozen=True, kw_only=True)
class BrownPhotogrammetric(Lens):
    """Brown 1966 as the paper uses it: corrects measured to ideal coordinates, in pixels.

    With ``x = col - (width-1)/2 - cl0``, ``y = row - (height-1)/2 - rw0``, ``r² = x² + y²``::

        x_ideal = x + x (k1 r² + k2 r⁴) + p1 (r² + 2x²) + 2 p2 x y
        y_ideal = y + y (k1 r² + k2 r⁴) + p2 (r² + 2y²) + 2 p1 x y
        (u/w, v/w) = (x_ideal, y_ideal) pixel_size / f
    """

    focal_length_mm: float
    pixel_size_mm: float
    cl0_px: float = 0.0
    rw0_px: float = 0.0
    k1_px2: float = 0.0
    k2_px4: float = 0.0
    p1_px: float = 0.0
    p2_px: float = 0.0

    @property
    def principal_distance_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm / self.pixel_size_mm

    @property
    def principal_point_px(self) -> Array:
        """(col, row) from which the offsets x, y are measured."""
        return np.array(
            [(self.width_px - 1) / 2 + self.cl0_px, (self.height_px - 1) / 2 + self.rw0_px]
        )

    def numbers(self) -> LensNumbers:
        """Return the numbers by name, all in pixels."""
        f_px, (col, row) = self.principal_distance_px, self.principal_point_px
        return LensNumbers(
            plumb_bob=0.0, fx=f_px, fy=f_px, col=col, row=row,
            k1=self.k1_px2, k2=self.k2_px4, k3=0.0, p1=self.p1_px, p2=self.p2_px,
        )  # fmt: skip

    def normalised_from_pixels(self, pixels: Array) -> Array:
        """Return (x/z, y/z); closed form."""
        xy = pixels - self.principal_point_px
        return self._ideal_from_measured(xy)[0] / self.principal_distance_px

    def pixels_from_normalised(self, normalised: Array) -> tuple[Array, Array]:
        """Return pixels and derivative; Newton's method on the closed form of the inverse."""
        ideal = normalised * self.principal_distance_px
        xy = inverted(self._ideal_from_measured, ideal, float(self.width_px))
        _, d_ideal_d_measured = self._ideal_from_measured(xy)
        jacobian = inverse_2x2(d_ideal_d_measured) * self.principal_distance_px
        return xy + self.principal_point_px, jacobian

    def _ideal_from_measured(self, xy: Array) -> tuple[Array, Array]:
        # p1 and p2 trade places between Brown's and OpenCV's order of the tangential terms.
        radial = (self.k1_px2, self.k2_px4, 0.0)
        return brown_polynomial(xy, radial, along_x=self.p1_px, along_y=self.p2_px)

    def to_plumb_bob(self) -> tuple[PlumbBob, float]:
        """Return the nearest plumb_bob lens, and its largest error over the image in px.

        With one focal length the fit is linear in (f, cx, cy, f k1, f k2, f k3, f p1, f p2).
        """
        pixels = self.pixel_grid()
        x, y = self.normalised_from_pixels(pixels).T
        r2, one, zero = x * x + y * y, np.ones_like(x), np.zeros_like(x)
        powers = [r2, r2**2, r2**3]
        columns_of_col = [x, one, zero, *(x * p for p in powers), 2 * x * y, r2 + 2 * x * x]
        columns_of_row = [y, zero, one, *(y * p for p in powers), r2 + 2 * y * y, 2 * x * y]
        design = np.vstack([np.column_stack(columns_of_col), np.column_stack(columns_of_row)])
        scale = np.abs(design).max(axis=0)
        solution = np.linalg.lstsq(design / scale, pixels.T.ravel(), rcond=None)[0] / scale
        f, cx, cy = (float(value) for value in solution[:3])
        k1, k2, k3, p1, p2 = (float(value) for value in solution[3:] / f)
        lens = PlumbBob(
            width_px=self.width_px, height_px=self.height_px, fx_px=f, fy_px=f, cx_px=cx,
            cy_px=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3,
        )  # fmt: skip
        return lens, self.largest_difference_px(lens)


@dataclass(frozen=True, kw_only=True)
class PlumbBob(Lens):
    """OpenCV's model, ideal to distorted in normalised coordinates; CameraInfo carries it.

    With ``(x, y) = (u/w, v/w)``, ``r² = x² + y²``::

        x_distorted = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2x²)
        y_distorted = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2y²) + 2 p2 x y
        col = fx x_distorted + cx,  row = fy y_distorted + cy
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def camera_matrix(self) -> Array:
        """K of CameraInfo and OpenCV, (3, 3)."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def distortion(self) -> Array:
        """D of CameraInfo and OpenCV: (k1, k2, p1, p2, k3)."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3])

    def numbers(self) -> LensNumbers:
        """Return the numbers by name; the tangential terms trade places, as Brown orders them."""
        return LensNumbers(
            plumb_bob=1.0, fx=self.fx_px, fy=self.fy_px, col=self.cx_px, row=self.cy_px,
            k1=self.k1, k2=self.k2, k3=self.k3, p1=self.p2, p2=self.p1,
        )  # fmt: skip

    def normalised_from_pixels(self, pixels: Array) -> Array:
        """Return (x/z, y/z); Newton's method, NaN where the model folds back."""
        distorted = (pixels - [self.cx_px, self.cy_px]) / [self.fx_px, self.fy_px]
        return inverted(self._distorted_from_ideal, distorted, 1.0)

    def pixels_from_normalised(self, normalised: Array) -> tuple[Array, Array]:
        """Return pixels and derivative; closed form, NaN where the model folds back."""
        focal = np.array([self.fx_px, self.fy_px])
        distorted, jacobian = self._distorted_from_ideal(normalised)
        unfolded = self._is_unfolded(normalised)
        pixels = distorted * focal + [self.cx_px, self.cy_px]
        return np.where(unfolded[:, None], pixels, np.nan), focal[:, None] * jacobian

    def _distorted_from_ideal(self, xy: Array) -> tuple[Array, Array]:
        return brown_polynomial(xy, (self.k1, self.k2, self.k3), along_x=self.p2, along_y=self.p1)

    def _is_unfolded(self, xy: Array) -> NDArray[np.bool_]:
        """Tell where the radius still grows, that is below the first zero of d(r_d)/dr."""
        roots = np.roots([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        folds = [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0.0]
        r2 = np.sum(xy * xy, axis=1)
        return np.asarray(r2 < min(folds, default=np.inf))

    def to_brown(self, pixel_size_mm: float) -> tuple[BrownPhotogrammetric, float]:
        """Return the nearest Brown lens, and its largest error over the image in px.

        Gauss-Newton in (f, cl0, rw0, k1, k2, p1, p2) on the rays of a grid of pixels.
        """
        pixels = self.pixel_grid()
        wanted = self.normalised_from_pixels(pixels)
        start = BrownPhotogrammetric(
            width_px=self.width_px, height_px=self.height_px, pixel_size_mm=pixel_size_mm,
            focal_length_mm=pixel_size_mm * (self.fx_px + self.fy_px) / 2,
            cl0_px=self.cx_px - (self.width_px - 1) / 2,
            rw0_px=self.cy_px - (self.height_px - 1) / 2,
        )  # fmt: skip
        r = self.width_px / 2
        steps = {
            "focal_length_mm": 1e-3 * start.focal_length_mm, "cl0_px": 0.1, "rw0_px": 0.1,
            "k1_px2": 1e-3 / r**2, "k2_px4": 1e-3 / r**4, "p1_px": 1e-4 / r, "p2_px": 1e-4 / r,
        }  # fmt: skip
        lens = start
        for _ in range(20):
            residual = (lens.normalised_from_pixels(pixels) - wanted).ravel()
            columns = [
                (_stepped(lens, name, step).normalised_from_pixels(pixels)
                 - _stepped(lens, name, -step).normalised_from_pixels(pixels)).ravel() / 2
                for name, step in steps.items()
            ]  # fmt: skip
            change = np.linalg.lstsq(np.column_stack(columns), -residual, rcond=None)[0]
            for (name, step), amount in zip(steps.items(), change, strict=True):
                lens = _stepped(lens, name, float(step * amount))
            if np.abs(change).max() < 1e-9:
                break
        return lens, self.largest_difference_px(lens)


def check_lens(lens: Lens) -> None:
    """Raise InputError where a lens has numbers that no lens can have."""
    for field in fields(lens):
        value = getattr(lens, field.name)
        if not np.isfinite(value):
            raise InputError(f"Expected a finite number for {field.name}, got {value}.")
    for name in ("width_px", "height_px", "focal_length_mm", "pixel_size_mm", "fx_px", "fy_px"):
        if getattr(lens, name, 1.0) <= 0:
            raise InputError(f"Expected {name} above zero, got {getattr(lens, name)}.")
    border = lens.pixel_grid(9)
    error = np.abs(lens.project(lens.rays(border)) - border)
    if not np.all(error < 1e-6):
        raise InputError(
            "Expected a lens that sees every pixel of its image in one direction only; with these"
            " distortion coefficients the image folds back on itself. Check their units and signs."
        )


def _stepped(lens: AnyLens, name: str, amount: float) -> AnyLens:
    return replace(lens, **{name: getattr(lens, name) + amount})


def _points(values: ArrayLike, size: int, name: str) -> Array:
    array = np.asarray(values, dtype=float)
    if array.ndim != 2 or array.shape[1] != size:
        raise InputError(f"Expected {name} of shape (N, {size}), got {array.shape}.")
    return array
