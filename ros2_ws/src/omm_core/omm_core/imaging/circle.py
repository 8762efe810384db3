r"""The centre of the image of a circle, which is not the image of the circle's centre.

Perspective shifts the centre of the ellipse (on the paper's camera 0.1 px for an 8 mm dot at
300 mm, off axis), and the lens bends the ellipse, which shifts it as much again. The outline is
therefore projected as it is: at N = 8 points of the circle, through the lens. It is a trigonometric
polynomial of the angle t around the circle whose terms fall off fast (dot radius / distance)::

    m(t) = m0 + u cos t + v sin t + e cos 2t + f sin 2t + ...

u and v make the ellipse; m0 is the mean of the outline, not yet its centre: the second harmonic
holds a part of the shift. Two centres are told apart where it is bent (by symmetry, odd and even
harmonics do not mix to first order; K1 and K2 are 2 x 2 and depend on u and v only)::

    centre = m0 + K1 e + K2 f

``AREA``
    centre of gravity of the bright area, what a centroid measures. In the frame in which the
    ellipse is the unit circle, T = [u v], a least-squares circle through the outline has the same
    centre: ``K1 = T diag(1/2, -1/2) T⁻¹``, ``K2 = T [[0, 1/2], [1/2, 0]] T⁻¹``.
``OUTLINE``
    centre of the ellipse that fits the outline best by distance, each piece of it weighted by its
    length: what a least-squares fit of an ellipse or of a blurred disc to an image measures. With
    the normal n(t) and ds = \|m'(t)\| dt:
    ``K1 = (∫ n nᵀ ds)⁻¹ ∫ n nᵀ cos 2t ds``, K2 with sin 2t.

For a dot seen face on they are the same; at 45°, 8 mm and 300 mm they differ by up to 0.003 px,
at 15 mm and 150 mm by 0.035 px. Sources: Luhmann 2014 (eccentricity in image measurement of
circular targets); Song et al. 2024 ("discocal", moments of a disc's image under distortion). The
error that is left is measured in test_circle_centre.py.
"""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omm_core.imaging.lens import Lens

Array = NDArray[np.float64]

BOUNDARY_POINTS = 8
ANGLES = 2.0 * np.pi * np.arange(BOUNDARY_POINTS) / BOUNDARY_POINTS
# ∫ … ds over half the outline (the integrands have period π), by the trapezoid rule.
QUADRATURE_ANGLES = np.pi * np.arange(12) / 12


class CircleCentre(enum.IntEnum):
    """Which centre of the image of a circle is meant, see the module's description."""

    AREA = 0
    OUTLINE = 1


def circle_points(centre: ArrayLike, normal: ArrayLike, diameter_mm: ArrayLike) -> Array:
    """Return the points of circles at which their outlines are projected.

    Parameters
    ----------
    centre, normal : (N, 3) arrays
        In any one frame; mm, unit vectors of either sign.
    diameter_mm : (N,) array

    Returns
    -------
    (N, BOUNDARY_POINTS, 3) array
        In the same frame, mm, evenly around each circle.
    """
    centre, normal = np.asarray(centre, dtype=float), np.asarray(normal, dtype=float)
    # Any vector in the plane serves: start from the axis that is farthest from the normal.
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=-1)]
    a = np.cross(normal, axis)
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    b = np.cross(normal, a)
    around = np.cos(ANGLES)[:, None] * a[..., None, :] + np.sin(ANGLES)[:, None] * b[..., None, :]
    radius = np.asarray(diameter_mm, dtype=float)[..., None, None] / 2
    return np.asarray(centre[..., None, :] + radius * around)


def centre_weights(outline_px: Array, kind: CircleCentre = CircleCentre.OUTLINE) -> Array:
    """Return the matrices B_k of ``centre = Σ B_k m_k`` for one outline.

    Parameters
    ----------
    outline_px : (BOUNDARY_POINTS, 2) array
        Pixels of the projected points.
    kind : CircleCentre
        Which centre.

    Returns
    -------
    (BOUNDARY_POINTS, 2, 2) array
        They change only with the shape of the ellipse, so that ``d(centre) = Σ B_k dm_k``
        (test_circle_centre.py measures what that leaves out).
    """
    u, v = (2.0 / BOUNDARY_POINTS) * np.stack([np.cos(ANGLES), np.sin(ANGLES)]) @ outline_px
    if kind == CircleCentre.AREA:
        to_ellipse = np.column_stack([u, v])
        to_circle = np.linalg.inv(to_ellipse)
        k1 = to_ellipse @ np.array([[0.5, 0.0], [0.0, -0.5]]) @ to_circle
        k2 = to_ellipse @ np.array([[0.0, 0.5], [0.5, 0.0]]) @ to_circle
    else:
        t = QUADRATURE_ANGLES[:, None]
        tangent = -u * np.sin(t) + v * np.cos(t)
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
        # The normal has the length of the tangent: n nᵀ ds = normal normalᵀ / |tangent| dt.
        weight = (
            normal[:, :, None] * normal[:, None, :] / np.linalg.norm(tangent, axis=1)[:, None, None]
        )
        inverse = np.linalg.inv(weight.sum(axis=0))
        k1 = inverse @ np.tensordot(np.cos(2 * QUADRATURE_ANGLES), weight, axes=1)
        k2 = inverse @ np.tensordot(np.sin(2 * QUADRATURE_ANGLES), weight, axes=1)
    cos2, sin2 = (2.0 * g(2 * ANGLES)[:, None, None] for g in (np.cos, np.sin))
    return np.asarray((np.eye(2) + cos2 * k1 + sin2 * k2) / BOUNDARY_POINTS)


def project_circles(
    lens: Lens,
    centre_in_camera: ArrayLike,
    normal_in_camera: ArrayLike,
    diameter_mm: ArrayLike,
    kind: CircleCentre = CircleCentre.OUTLINE,
) -> Array:
    """Return the centres of the images of circles.

    Parameters
    ----------
    lens : Lens
    centre_in_camera, normal_in_camera : (N, 3) arrays
        ``camera_optical``; mm, unit vectors of either sign.
    diameter_mm : (N,) array
    kind : CircleCentre
        Which centre.

    Returns
    -------
    (N, 2) array
        (col, row) px; NaN where the lens cannot see the whole circle.
    """
    points = circle_points(centre_in_camera, normal_in_camera, diameter_mm)
    outlines = lens.project(points.reshape(-1, 3)).reshape(-1, BOUNDARY_POINTS, 2)
    centres = np.full((len(outlines), 2), np.nan)
    for i, outline in enumerate(outlines):
        if np.isfinite(outline).all():
            centres[i] = np.einsum("kij,kj->i", centre_weights(outline, kind), outline)
    return centres


def centre_weights_of_many(outlines_px: Array) -> Array:
    """Return :func:`centre_weights` (OUTLINE) of many outlines at once.

    Parameters
    ----------
    outlines_px : (N, BOUNDARY_POINTS, 2) array

    Returns
    -------
    (N, BOUNDARY_POINTS, 2, 2) array
    """
    harmonics = (2.0 / BOUNDARY_POINTS) * np.stack([np.cos(ANGLES), np.sin(ANGLES)])
    u, v = np.moveaxis(harmonics @ outlines_px, 1, 0)[:, :, None, :]
    t = QUADRATURE_ANGLES[:, None]
    tangent = -u * np.sin(t) + v * np.cos(t)
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    length = np.linalg.norm(tangent, axis=-1)[..., None, None]
    weight = normal[..., :, None] * normal[..., None, :] / length
    inverse = np.linalg.inv(weight.sum(axis=1))
    k1, k2 = (
        inverse @ np.einsum("q,nqij->nij", g(2 * QUADRATURE_ANGLES), weight)
        for g in (np.cos, np.sin)
    )
    cos2, sin2 = (2.0 * g(2 * ANGLES)[:, None, None] for g in (np.cos, np.sin))
    return np.asarray((np.eye(2) + cos2 * k1[:, None] + sin2 * k2[:, None]) / BOUNDARY_POINTS)
