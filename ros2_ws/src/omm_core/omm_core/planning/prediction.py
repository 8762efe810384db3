"""The covariance that stops will give, in the machine's own coordinates.

With θ the pose in local unknowns (kernels.py), g the geometry's errors at the stops, e the rest::

    y = A θ + D g + e,        D = -∂y/∂place            (the spindle moves: the part moves back)

The own pose is the absolute one minus the rigid fit, over the targets, of the mean error at the
stops that saw each: θ_own = θ - F g. Put in, ``y = A θ_own + (D + A F) g + e``. θ_own has no prior,
and (θ, g) to (θ_own, g) has the determinant 1; so its covariance is that of plain generalised
least squares with the geometry's design replaced::

    Q_own = (Aᵀ V⁻¹ A)⁻¹,   D' = D + A F,
    V = V_image + σ_stop² D Dᵀ + σ_geo² D' (k_l ⊗ I) D'ᵀ + V_targets + V_calibration

which tells what the estimator's best linear prediction of own coordinates tells
(test_planning_prediction.py holds the two against each other).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.part_pose.adjustment import Adjustment
from omm_core.part_pose.kernels import predict_all
from omm_core.part_pose.model import PixelModel
from omm_core.planning.scene import CENTRE_KIND, REFERENCE_DIAMETER_PX, AssumedNoise, Scene
from omm_core.planning.views import Views

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SCALE = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0, 1e-3])  # rad beside mm
_WEAKEST = 1e-9  # information that any set has: a set that determines nothing comes out huge


@dataclass(frozen=True, kw_only=True, eq=False)
class Designs:
    """What each of many stops observes, with room for K targets; K of the stop that sees most.

    Attributes
    ----------
    target : (C, K) array of int
        Row in the part's targets; -1 where there is none.
    A : (C, 2K, 7) array
        Derivatives of the pixels by the local unknowns; zeros where there is no target.
    common : (C, 2K, Q) array
        By standard normal errors that all stops share: targets and calibration.
    variance : (C, 2K) array
        Of the image, px²; 1 where there is no target.
    place_mm : (C, 3) array
        Commanded spindle.
    by_target : (T, 3, 6) array
        Derivatives of the targets' places by the local unknowns, machine frame.
    """

    target: Indices
    A: Array
    common: Array
    variance: Array
    place_mm: Array
    by_target: Array


def local_state(scene: Scene) -> tuple[Adjustment, Array]:
    """Return the part's place in the kernels' unknowns, and X_0 (3,)."""
    X0 = np.mean([target.xyz_mm for target in scene.part.targets], axis=0)
    R = np.ascontiguousarray(scene.machine_T_part.rotation)
    state = Adjustment(
        rotation=R, d0_mm=np.asarray(scene.machine_T_part @ X0), gamma_s_rad=scene.gamma_s_rad,
        cost=0.0, normal=np.zeros((7, 7)), converged=True, iterations=0,
    )  # fmt: skip
    return state, X0


def designs(scene: Scene, spindles: Sequence[RigidTransform], seen: Views) -> Designs:
    """Return what stops observe of all targets that they see."""
    stop, target = np.nonzero(seen.visible)
    counts = seen.visible.sum(axis=1)
    slots = max(int(counts.max(initial=0)), 1)
    slot = np.arange(len(stop)) - np.repeat(np.cumsum(counts) - counts, counts)
    _pixels, A = _predicted(scene, scene.calibration, spindles, stop, target)
    common = _common(scene, spindles, stop, target, A)
    sigma = scene.noise.image_sigma_px * np.sqrt(
        np.maximum(1.0, REFERENCE_DIAMETER_PX / seen.diameter_px[stop, target])
    )
    shape = (len(spindles), slots, 2)
    out_A, out_common = np.zeros((*shape, 7)), np.zeros((*shape, common.shape[2]))
    variance, table = np.ones(shape), np.full(shape[:2], -1, dtype=np.int64)
    out_A[stop, slot], out_common[stop, slot] = A, common
    variance[stop, slot], table[stop, slot] = sigma[:, None] ** 2, target
    rows = (len(spindles), 2 * slots)
    return Designs(
        target=table, A=out_A.reshape(*rows, 7), common=out_common.reshape(*rows, -1),
        variance=variance.reshape(rows),
        place_mm=np.array([s.translation_mm for s in spindles]).reshape(-1, 3),
        by_target=_places_by_pose(scene),
    )  # fmt: skip


def own_covariances(designs: Designs, noise: AssumedNoise, sets: Indices) -> Array:
    """Return the covariances in own coordinates of sets of stops.

    Parameters
    ----------
    sets : (B, S) array of int
        Rows of ``designs``.

    Returns
    -------
    (B, 7, 7) array
        Of (ω, d_0, γ_s); huge where a set does not determine them.
    """
    A, V = stacked(designs, noise, sets)
    scaled = A * _SCALE
    normal = np.swapaxes(scaled, 1, 2) @ np.linalg.solve(V, scaled)
    normal[:, range(7), range(7)] += _WEAKEST
    return np.asarray(np.linalg.inv(normal) * np.outer(_SCALE, _SCALE))


def determines(designs: Designs, stops: Indices) -> bool:
    """Return whether stops see three targets or more that do not lie on a line."""
    seen = np.unique(designs.target[stops])
    B = (designs.by_target[seen[seen >= 0]] * _SCALE[:6]).reshape(-1, 6)
    values = np.linalg.svd(B, compute_uv=False) if len(B) >= 6 else np.zeros(6)
    return bool(values[-1] > 1e-4 * values[0])


def stacked(designs: Designs, noise: AssumedNoise, sets: Indices) -> tuple[Array, Array]:
    """Return A (B, n, 7) and V (B, n, n) of sets of stops (B, S), as the module's text has them."""
    batch, stops = sets.shape
    A = designs.A[sets]
    rows = A.shape[2]
    D = -A[..., 3:6]  # (B, S, rows, 3): at its own stop only
    n = stops * rows
    A_flat = A.reshape(batch, n, 7)
    common = designs.common[sets].reshape(batch, n, -1)
    V = common @ np.swapaxes(common, 1, 2)
    at_stop = noise.stop_sigma_mm**2 * D @ np.swapaxes(D, 2, 3)
    for s in range(stops):
        own = slice(s * rows, (s + 1) * rows)
        V[:, own, own] += at_stop[:, s]
    V[:, range(n), range(n)] += designs.variance[sets].reshape(batch, n)
    if noise.geometry_sigma_mm > 0.0:
        by_stop = A_flat[..., :6] @ np.moveaxis(_fit(designs, sets), 1, 2).reshape(batch, 6, -1)
        by_stop = by_stop.reshape(batch, n, stops, 3)
        for s in range(stops):
            by_stop[:, s * rows : (s + 1) * rows, s] += D[:, s]
        V += _geometry(by_stop, designs.place_mm[sets], noise)
    return A_flat, V


def _geometry(by_stop: Array, places: Array, noise: AssumedNoise) -> Array:
    batch, n, stops, _ = by_stop.shape
    squared = np.sum((places[:, :, None] - places[:, None]) ** 2, axis=3)
    k = noise.geometry_sigma_mm**2 * np.exp(-0.5 * squared / noise.geometry_length_mm**2)
    spread = np.moveaxis(by_stop, 3, 2)  # (B, n, 3, S)
    weighed = spread @ k[:, None]
    flat = (batch, n, 3 * stops)
    return np.asarray(weighed.reshape(flat) @ np.swapaxes(spread.reshape(flat), 1, 2))


def _fit(designs: Designs, sets: Indices) -> Array:
    """Return d(ω, d_0)/dg of the unweighted rigid fit for each stop, (B, S, 6, 3)."""
    target = designs.target[sets]
    targets = len(designs.by_target)
    sees = (target[..., None] == np.arange(targets)).any(axis=2)  # (B, S, T)
    times = sees.sum(axis=1)
    weight = sees / np.maximum(times, 1)[:, None]
    scale = _SCALE[:6]
    B = designs.by_target * scale
    normal = np.einsum("bt,tij,tik->bjk", (times > 0).astype(float), B, B)
    normal[:, range(6), range(6)] += _WEAKEST
    gain = np.einsum("bst,tij->bsji", weight, B)
    return np.asarray(scale[:, None] * np.linalg.solve(normal[:, None], gain))


def _places_by_pose(scene: Scene) -> Array:
    """Return d(place)/d(ω, d_0) of each target, (T, 3, 6): ω x (R_p Y) + d_0."""
    state, X0 = local_state(scene)
    by_pose = np.zeros((len(scene.part.targets), 3, 6))
    by_pose[:, range(3), range(3, 6)] = 1.0
    for i, target in enumerate(scene.part.targets):
        by_pose[i, :, :3] = turned(state.rotation @ (target.xyz_mm - X0))
    return by_pose


def turned(r: Array) -> Array:
    """Return d(ω x r)/dω, (3, 3)."""
    x, y, z = r
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def _predicted(
    scene: Scene,
    calibration: CameraCalibration,
    spindles: Sequence[RigidTransform],
    stop: Indices,
    target: Indices,
) -> tuple[Array, Array]:
    """Return pixels (N, 2) and derivatives (N, 2, 7) of targets at stops."""
    state, X0 = local_state(scene)
    pose = calibration.taper_T_camera
    pixels, A = np.empty((len(stop), 2)), np.empty((len(stop), 2, 7))
    model = PixelModel(
        lens=calibration.lens.kernel_parameters(),
        centre_kind=CENTRE_KIND,
        R_calib=pose.rotation.copy(),
        d_calib=pose.translation_mm.copy(),
        R_cnc=np.array([s.rotation for s in spindles]).reshape(-1, 3, 3),
        d_cnc=np.array([s.translation_mm for s in spindles]).reshape(-1, 3),
        image_of=stop.astype(np.int64),
        target_of=target.astype(np.int64),
        points=np.ascontiguousarray(scene.circles(1.0) - X0),
    )
    predict_all(model, state.rotation.copy(), state.d0_mm.copy(), state.gamma_s_rad, pixels, A)
    return pixels, A


def _common(scene: Scene, spindles, stop, target, A: Array) -> Array:  # type: ignore[no-untyped-def]
    """Return derivatives by the standard normal errors of targets and calibration, (N, 2, Q)."""
    by_place = A[:, :, 3:6] @ scene.machine_T_part.rotation
    covariance = scene.part.target_covariance_mm2()
    blocks = []
    if np.any(covariance):
        spread = np.zeros((len(stop), 2, len(scene.part.targets), 3))
        spread[np.arange(len(stop)), :, target] = by_place
        blocks.append(spread.reshape(len(stop), 2, -1) @ _root(covariance))
    names, known = scene.calibration.parameters, scene.calibration.covariance
    if names and np.any(known):
        blocks.append(_by_calibration(scene, spindles, stop, target) @ _root(known))
    return np.concatenate([np.zeros((len(stop), 2, 0)), *blocks], axis=2)


def _by_calibration(scene: Scene, spindles, stop, target) -> Array:  # type: ignore[no-untyped-def]
    """Return d(pixel)/d(parameter) by central differences of one sigma, (N, 2, P)."""
    calibration = scene.calibration
    names = calibration.parameters
    values, sigma = calibration.parameter_values(names), np.sqrt(np.diag(calibration.covariance))
    columns = []
    for index, size in enumerate(sigma):
        step = np.zeros(len(names))
        step[index] = size
        up, down = (
            _predicted(
                scene,
                calibration.with_parameters(names, values + sign * step),
                spindles,
                stop,
                target,
            )[0]
            for sign in (1.0, -1.0)
        )
        columns.append((up - down) / (2.0 * size) if size > 0.0 else np.zeros((len(stop), 2)))
    return np.stack(columns, axis=2)


def _root(covariance: Array) -> Array:
    """Return L with L Lᵀ the covariance; columns that hold nothing are left out."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > 1e-12 * values.max()
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))
