"""What a run tells of changes of the camera, over all machines there may be (see check.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.noise_model import NoiseModel
from omm_core.part_pose.posterior import Posterior, noise_matrices

Array = NDArray[np.float64]

_POWER_Z = 1.645  # 19 of 20
_UNSEEN = 1.0  # plausible changes smaller than this many sigma are not tested at all
_WEIGHT = 1e-4  # of machines that are left out


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """G (M, P, P) and h (M, P) in plausible changes, of each of the M likely machines."""

    weight: Array
    G: Array
    h: Array
    shift_mm: Array

    @classmethod
    def of(cls, model: NoiseModel, estimated: Posterior, effect: Array) -> Evidence:
        """Return it for the effect (n, P) of plausible changes on (u, z)."""
        u, z = model.unknowns, model.u_z[model.unknowns :]
        grid = estimated.grid
        known, image, stop, own, _ = noise_matrices(model, grid)
        likely = np.flatnonzero(estimated.weight > _WEIGHT * estimated.weight.max())
        weight = estimated.weight[likely] / estimated.weight[likely].sum()
        G, h, mean = [], [], np.zeros_like(known)
        for share, g in zip(weight, likely, strict=True):
            C = known + grid.image_scale[g] ** 2 * image + grid.stop_sigma_mm[g] ** 2 * stop
            C = C + grid.geometry_sigma_mm[g] ** 2 * own[grid.length_index[g]]
            mean += share * C
            solved = np.linalg.solve(C[u:, u:], np.column_stack([effect[u:], z]))
            G.append(effect[u:].T @ solved[:, :-1])
            h.append(effect[u:].T @ solved[:, -1])
        pose = effect[:u] - mean[:u, u:] @ np.linalg.solve(mean[u:, u:], effect[u:])
        return cls(weight=weight, G=np.array(G), h=np.array(h), shift_mm=_largest(model, pose))

    def everything(self) -> tuple[float, float, int]:
        """Return the test of all changes at once: p-value, chi-square, degrees of freedom."""
        from scipy.stats import chi2

        values, vectors = np.linalg.eigh(np.tensordot(self.weight, self.G, axes=1))
        V = vectors[:, values > _UNSEEN]
        if V.shape[1] == 0:
            return 1.0, 0.0, 0
        h = self.h @ V
        squares = np.einsum("mi,mi->m", h, np.linalg.solve(V.T @ self.G @ V, h[..., None])[..., 0])
        p_value = float(self.weight @ chi2.sf(squares, V.shape[1]))
        return p_value, float(self.weight @ squares), V.shape[1]

    def alone(self, i: int, doubt: float) -> tuple[float, float, float, float]:
        """Return change, sigma, p-value and detectable change of one parameter."""
        from scipy.stats import norm

        information = self.G[:, i, i]
        if not self.weight @ information > _UNSEEN:
            return 0.0, np.inf, 1.0, np.inf
        each = self.h[:, i] / information
        change = float(self.weight @ each)
        variance = float(self.weight @ (1 / information))
        p_value = float(self.weight @ (2 * norm.sf(np.abs(each) * np.sqrt(information))))
        detectable = (norm.isf(doubt / 2) + _POWER_Z) * np.sqrt(variance)
        spread = float(self.weight @ (each - change) ** 2)
        return change, float(np.sqrt(variance + spread)), p_value, float(detectable)


def _largest(model: NoiseModel, pose: Array) -> Array:
    """Return by how much a pose error (u, P) misplaces the target where it is largest, (P,) mm."""
    arms = model.problem.points[:, 0] @ model.adjustment.rotation.T
    turned = np.cross(pose[:3].T[:, None], arms[None])
    return np.asarray(np.linalg.norm(turned + pose[3:6].T[:, None], axis=2).max(axis=1))
