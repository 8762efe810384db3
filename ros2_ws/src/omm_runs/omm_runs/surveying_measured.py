"""A survey whose image points were measured elsewhere: AICON's export, adjusted anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omm_core.files.aicon import AiconNetwork, load_aicon
from omm_core.geometry import euler_xyz_rad_from_rotation
from omm_core.survey.aicon import PARAMETERS, AdjustedNetwork, adjust_aicon

# AICON's camera looks along -z with y up; camera_optical along +z with y down.
_OPTICAL = np.diag([1.0, -1.0, -1.0])
_SUSPECT = 0.25  # of the rays of a target or image
_TOLD = 5
_CAUSES = {
    "Target": "it moved, or its number was mistaken",
    "Image": "its numbers were mistaken, or zoom or focus was touched",
}


def survey_measured(folder: Path) -> dict[str, Any]:
    """Return the result in the form of ``survey --json``.

    Raises
    ------
    InputError
    """
    network = load_aicon(folder)
    found = adjust_aicon(network)
    solution = found.solution
    rays = np.bincount(
        np.searchsorted(found.points, network.point[found.used]), minlength=len(found.points)
    )
    findings = [
        "Image points measured elsewhere: all have one weight, and every covariance is scaled by"
        " the sigma0 that comes out, that of the bars too.",
        *left_out_words(network, found),
    ]
    bars = _bars(found, network.bars)
    if len(bars) == 1:
        findings.append("Only one scale bar: its length is not checked by anything.")
    return {
        "converged": solution.converged,
        "sigma0": solution.sigma0,
        "sigma0_mm": found.sigma0_mm,
        "rms_mm": float(np.sqrt(np.mean(solution.residuals["rays"][found.used] ** 2))),
        "rms_px": None,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "camera": {
            "parameters": list(PARAMETERS),
            "values": solution.values["lens"][0].tolist(),
            "covariance": found.covariance_of("lens").tolist(),
        },
        "points": _points(found, rays),
        "photos": _photos(found),
        "scale_bars": bars,
        "check_bars": [],
        "findings": findings,
    }


def left_out_words(network: AiconNetwork, found: AdjustedNetwork) -> list[str]:
    """Return what is told of the rays that are left out: of which points and images they are."""
    out = ~found.used
    if not out.any():
        return []
    words = []
    for what, of in (("Target", network.point), ("Image", network.image)):
        for number in np.unique(of[out]):
            gone, every = int(np.sum(out & (of == number))), int(np.sum(of == number))
            if gone >= 2 and gone >= _SUSPECT * every:
                words.append(
                    f"{what} {number}: {gone} of {every} rays do not fit and are left out;"
                    f" {_CAUSES[what]}."
                )
    away = np.linalg.norm(found.solution.residuals["rays"], axis=1)
    worst = np.flatnonzero(out)[np.argsort(-away[out])][:_TOLD]
    some = "; ".join(
        f"{network.point[i]} in image {network.image[i]}, {away[i]:.4f} mm" for i in worst
    )
    words.append(
        f"{int(out.sum())} of {len(out)} image points are left out as blunders (8 sigma or more):"
        f" {some}{' ...' if out.sum() > _TOLD else ''}."
    )
    return words


def _points(found: AdjustedNetwork, rays: Any) -> list[dict[str, Any]]:
    covariance = found.covariance_of("points")
    places = found.solution.values["points"]
    return [
        {
            "name": str(number), "coded": True, "id": number, "xyz_mm": places[row].tolist(),
            "covariance_mm2": covariance[3 * row : 3 * row + 3, 3 * row : 3 * row + 3].tolist(),
            "images": int(rays[row]),
        }
        for row, number in enumerate(found.points)
    ]  # fmt: skip


def _photos(found: AdjustedNetwork) -> list[dict[str, Any]]:
    sigmas = np.sqrt(np.diag(found.covariance_of("photos"))).reshape(-1, 6)
    photos = []
    for row, number in enumerate(found.images):
        pose = found.solution.values["photos"][row]
        turned = Rotation.from_rotvec(pose[:3]).as_matrix().T @ _OPTICAL
        euler = [float(angle) for angle in euler_xyz_rad_from_rotation(turned)]
        photos.append(
            {
                "file": str(number), "used": True, "reason": None,
                "position_mm": pose[3:].tolist(), "euler_xyz_rad": euler,
                "sigma_position_mm": sigmas[row, 3:].tolist(),
            }
        )  # fmt: skip
    return photos


def _bars(
    found: AdjustedNetwork, declared: tuple[tuple[int, int, float, float], ...]
) -> list[dict[str, Any]]:
    covariance, places = found.covariance_of("points"), found.solution.values["points"]
    row = {number: i for i, number in enumerate(found.points)}
    bars = []
    for a, b, length, _ in declared:
        if a in row and b in row:
            between = places[row[a]] - places[row[b]]
            measured = float(np.linalg.norm(between))
            which = np.r_[3 * row[a] : 3 * row[a] + 3, 3 * row[b] : 3 * row[b] + 3]
            along = np.r_[between, -between] / measured
            sigma = float(np.sqrt(along @ covariance[np.ix_(which, which)] @ along))
            bars.append(
                {"ends": [a, b], "length_mm": length, "measured_mm": measured, "sigma_mm": sigma}
            )
    return bars
