"""A survey from its folder: detect in all photographs, adjust, say what came out."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omm_core.files.output import write_whole
from omm_core.files.survey import DeclaredBar, SurveySet, load_survey
from omm_core.geometry import euler_xyz_rad_from_rotation
from omm_core.survey import Bar, Network, solve_network
from omm_core.survey.camera_model import PARAMETERS
from omm_core.survey.network import FEWEST_RAYS
from omm_core.survey.sighting import CODED, PLAIN, sighting_of_target
from omm_core.targets import TargetFamily
from omm_runs.photographs import look_at_all


def survey(path: Path) -> tuple[SurveySet, Network, dict[str, Any]]:
    """Return the set, the network, and its result as ``survey --json`` says it.

    Raises
    ------
    InputError, MeasurementError
    """
    given = load_survey(path)
    TargetFamily.by_name(given.target_family)
    size = (given.width_px, given.height_px)
    seen = look_at_all(given.photos, given.target_family, size)
    sightings = [
        sighting_of_target(number, target)
        for number, photo in enumerate(seen)
        for target in photo.targets
    ]
    dots = {number: photo.dots for number, photo in enumerate(seen)}
    bars = [Bar(ends=b.ends, length_mm=b.length_mm, sigma_mm=b.sigma_mm) for b in given.scale_bars]
    declared = {
        kind: diameter
        for kind, diameter in (
            (CODED, given.coded_dot_diameter_mm),
            (PLAIN, given.plain_dot_diameter_mm),
        )
        if diameter is not None
    }
    network = solve_network(sightings, bars, given.focal_length_px, size, dots, declared)
    return given, network, as_json(given, network)


def write_points(path: Path, given: SurveySet, network: Network, result: dict[str, Any]) -> None:
    """Write points.json, and the full covariance of its points (mm²) beside it.

    Raises
    ------
    InputError
        Where a file cannot be written.
    """
    names = {point["name"] for point in result["points"]}
    rows = [row for number, row in network.points.items() if name_of(number) in names]
    which = np.concatenate([np.arange(3 * row, 3 * row + 3) for row in rows])
    buffer = io.BytesIO()
    np.save(buffer, network.solution.covariance_of("points")[np.ix_(which, which)])
    beside = path.with_name(f"{path.stem}_covariance.npy")
    write_whole(beside, buffer.getvalue())
    content = {
        "target_family": given.target_family,
        "coded_dot_diameter_mm": given.coded_dot_diameter_mm,
        "plain_dot_diameter_mm": given.plain_dot_diameter_mm,
        "points": result["points"],
        "full_covariance": {
            "file": beside.name,
            "order": [point["name"] for point in result["points"]],
        },
    }
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def as_json(given: SurveySet, network: Network) -> dict[str, Any]:
    """Return the result in the form of ``survey --json``."""
    solution = network.solution
    findings: list[str] = []
    points = _points(network)
    photos = []
    for number, photo in enumerate(given.photos):
        row = network.photos.get(number)
        if row is None:
            reason = "too few targets in common with the rest of the network"
            findings.append(f"{photo.name} is left out: {reason}.")
        pose = None if row is None else solution.values["photos"][row]
        photos.append(_photo(photo.name, pose))
    rejected = int(np.sum(~network.used))
    if rejected:
        findings.append(f"{rejected} of {len(network.used)} image points are left out as blunders.")
    findings += _suspects(given, network)
    few = [name_of(p) for p in network.points if network.rays_of(p) < FEWEST_RAYS]
    if few:
        findings.append(
            f"Not delivered, with fewer than {FEWEST_RAYS} rays left: {', '.join(few)}."
            " Take photographs from there."
        )
    if _one_roll_angle(network):
        findings.append(
            "All photographs have nearly the same roll angle: the principal point is badly"
            " determined. Turn the camera by 90 degrees in a part of them."
        )
    if len(network.bars) == 1:
        findings.append("Only one scale bar: its length is not checked by anything.")
    scale_bars = _measured(network, given.scale_bars, "scale bar", findings)
    for bar, entry in zip(network.bars, scale_bars, strict=True):
        off = entry["measured_mm"] - bar.length_mm
        if len(network.bars) > 1 and abs(off) > 3 * bar.sigma_mm:
            findings.append(
                f"The scale bars disagree: {bar.ends[0]}-{bar.ends[1]} comes out {off:+.4f} mm off"
                f" its length, which is declared to {bar.sigma_mm:g} mm."
            )
    lens = solution.covariance_of("lens")
    return {
        "converged": solution.converged,
        "sigma0": network.sigma0,
        "sigma0_by": network.sigma0_by,
        "rms_px": network.rms_px,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "camera": {
            "parameters": list(PARAMETERS),
            "values": solution.values["lens"][0].tolist(),
            "covariance": lens.tolist(),
        },
        "points": points,
        "photos": photos,
        "scale_bars": scale_bars,
        "check_bars": _measured(network, given.check_bars, "check bar", findings),
        "findings": findings,
    }


def _suspects(given: SurveySet, network: Network) -> list[str]:
    """Name targets and photographs of which a quarter or more of the rays were left out."""
    found = []
    for what, numbers, name in (
        ("Target", [s.point for s in network.sightings], name_of),
        ("Photograph", [s.photo for s in network.sightings], lambda i: given.photos[i].name),
    ):
        every = np.array(numbers)
        for number in np.unique(every):
            out = int(np.sum(~network.used & (every == number)))
            of = int(np.sum(every == number))
            if out >= 2 and out >= 0.25 * of:
                found.append(
                    f"{what} {name(int(number))}: {out} of {of} rays do not fit and are left out;"
                    " it may have moved, been misread or be partly hidden."
                )
    return found


def _one_roll_angle(network: Network) -> bool:
    """Tell whether the camera was hardly turned about its axis, against the points' main plane."""
    centred = network.solution.values["points"] - network.solution.values["points"].mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    up = Rotation.from_rotvec(network.solution.values["photos"][:, :3]).apply(normal)
    across = np.hypot(up[:, 0], up[:, 1])
    tilted = across > 0.2  # seen face on, the roll angle is not told by the normal
    if tilted.sum() < 3 or tilted.sum() < 0.5 * len(up):
        return False
    directions = up[tilted, :2] / across[tilted, None]
    return bool(np.linalg.norm(directions.mean(axis=0)) > 0.97)


def _points(network: Network) -> list[dict[str, Any]]:
    covariance = network.solution.covariance_of("points")
    points = []
    for number, row in network.points.items():
        rays = network.rays_of(number)
        if rays < FEWEST_RAYS:
            continue
        own = slice(3 * row, 3 * row + 3)
        circle = network.circles.get(number)
        points.append(
            {
                "name": name_of(number),
                "coded": number > 0,
                **({"id": number} if number > 0 else {}),
                "xyz_mm": network.solution.values["points"][row].tolist(),
                "covariance_mm2": covariance[own, own].tolist(),
                "normal": None if circle is None else circle.normal.tolist(),
                "images": rays,
            }
        )
    return points


def name_of(number: int) -> str:
    """Return what a point is called: a coded target's number, or P and a number."""
    return str(number) if number > 0 else f"P{-number}"


def _photo(name: str, pose: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {"file": name, "used": pose is not None, "reason": None}
    if pose is None:
        entry["reason"] = "too few targets in common with the rest of the network"
        return {**entry, "position_mm": None, "euler_xyz_rad": None}
    turned = Rotation.from_rotvec(pose[:3]).as_matrix().T
    euler = [float(angle) for angle in euler_xyz_rad_from_rotation(turned)]
    return {**entry, "position_mm": pose[3:].tolist(), "euler_xyz_rad": euler}


def _measured(
    network: Network, bars: tuple[DeclaredBar, ...], what: str, findings: list[str]
) -> list[dict[str, Any]]:
    entries = []
    for bar in bars:
        if not all(end in network.points for end in bar.ends):
            findings.append(
                f"The {what} {bar.ends[0]}-{bar.ends[1]} could not be measured: its ends are not"
                f" both seen in {FEWEST_RAYS} photographs."
            )
            continue
        measured, sigma = network.length(bar.ends)
        entries.append(
            {
                "ends": list(bar.ends),
                "length_mm": bar.length_mm,
                "measured_mm": measured,
                "sigma_mm": sigma,
            }
        )
    return entries
