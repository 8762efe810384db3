"""What a survey delivers: the JSON of ``survey --json``, and points.json with its covariance."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.files.output import write_whole
from omm_core.files.survey import DeclaredBar, DeclaredDatum, SurveySet
from omm_core.geometry import euler_xyz_rad_from_rotation
from omm_core.survey import Network
from omm_core.survey.advice import where_to_stand
from omm_core.survey.camera_model import PARAMETERS
from omm_core.survey.datum import Frame, frame_of_nominal, frame_of_three, free_frame
from omm_core.survey.network import FEWEST_RAYS
from omm_core.survey.sighting import CODED, PLAIN
from omm_core.survey.words import findings_of, name_of, photo_reasons
from omm_core.survey.zooming import TOUCHED
from omm_runs.survey_cameras import Group, shifts_px, zoom_advice

Array = NDArray[np.float64]
_CHECK_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Delivered:
    """The points that are delivered: numbers, places (n, 3) and covariance (3n, 3n), mm."""

    numbers: tuple[int, ...]
    frame: Frame
    xyz_mm: Array
    covariance_mm2: Array
    words: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyResult:
    """A finished survey."""

    given: SurveySet
    network: Network
    delivered: Delivered
    json: dict[str, Any]


def delivered(network: Network, datum: DeclaredDatum) -> Delivered:
    """Return the points with enough rays in the wanted datum.

    Raises
    ------
    MeasurementError
        Where the targets of the datum are not among them.
    """
    rays = network.ray_counts()
    numbers = tuple(n for n in sorted(network.points, key=_order) if rays[n] >= FEWEST_RAYS)
    rows = np.array([network.points[n] for n in numbers])
    points = network.solution.values["points"][rows]
    which = (3 * rows[:, None] + np.arange(3)).ravel()
    covariance = network.solution.covariance_of("points")[np.ix_(which, which)]
    frame, words = _frame(points, numbers, datum)
    return Delivered(
        numbers=numbers, frame=frame, xyz_mm=frame.moved(points),
        covariance_mm2=frame.covariance(points, covariance), words=tuple(words),
    )  # fmt: skip


def _order(number: int) -> tuple[bool, int]:
    return number < 0, abs(number)


def _frame(
    points: Array, numbers: tuple[int, ...], datum: DeclaredDatum
) -> tuple[Frame, list[str]]:
    from omm_core.errors import MeasurementError

    at = {n: row for row, n in enumerate(numbers)}
    if datum.kind == "three_targets":
        missing = [t for t in datum.targets if t not in at]
        if missing:
            raise MeasurementError(
                f"Expected the datum's targets {datum.targets} among the measured ones; not"
                f" measured: {', '.join(map(str, missing))}."
            )
        a, b, c = (at[t] for t in datum.targets)
        return frame_of_three(points, (a, b, c)), []
    if datum.kind == "nominal" and datum.nominal_mm is not None:
        there = [n for n in datum.nominal_mm if n in at]
        nominal = np.array([datum.nominal_mm[n] for n in there]).reshape(-1, 3)
        frame, left = frame_of_nominal(points, [at[n] for n in there], nominal)
        worst = int(np.argmax(np.linalg.norm(left, axis=1)))
        return frame, [
            f"Fitted to {len(there)} nominal targets: rms {np.sqrt(np.mean(left**2)):.4f} mm per"
            f" axis, at most {np.linalg.norm(left[worst]):.4f} mm at {there[worst]}."
        ]
    return free_frame(points), []


def as_json(
    given: SurveySet,
    network: Network,
    out: Delivered,
    left_out: Mapping[int, str],
    groups: list[Group],
    words: list[str],
) -> dict[str, Any]:
    """Return the result in the form of ``survey --json``."""
    names = [photo.name for photo in given.photos]
    reasons = photo_reasons(len(names), network, left_out)
    findings = [*words, *out.words, *findings_of(network, lambda n: names[n], _nominal(groups))]
    findings += where_to_stand(network, out.frame)
    findings += [f"{names[n]} is left out: {why}." for n, why in sorted(reasons.items())]
    findings += zoom_advice([names[n] for n in sorted(reasons) if TOUCHED in reasons[n]])
    solution = network.solution
    return {
        "converged": solution.converged,
        "sigma0": network.sigma0,
        "sigma0_by": network.sigma0_by,
        "rms_px": network.rms_px,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "camera": _camera(network, 0),
        **_several(network),
        "points": _points(network, out),
        "photos": [_photo(n, name, network, out, reasons) for n, name in enumerate(names)],
        "scale_bars": measured_bars(network, given.scale_bars, "scale bar", findings),
        "check_bars": measured_bars(network, given.check_bars, "check bar", findings),
        "findings": findings,
        "observations": _observations(network, names, shifts_px(groups)),
    }


def _camera(network: Network, row: int) -> dict[str, Any]:
    own = slice(row * len(PARAMETERS), (row + 1) * len(PARAMETERS))
    return {
        "parameters": list(PARAMETERS),
        "values": network.solution.values["lens"][row].tolist(),
        "covariance": network.solution.covariance_of("lens")[own, own].tolist(),
    }


def _several(network: Network) -> dict[str, Any]:
    """Return all cameras, by name and photographs, where there are more than one."""
    if len(network.cameras) == 1:
        return {}
    counts = np.bincount(network.cameras.rows(network.photos), minlength=len(network.cameras))
    return {
        "cameras": [
            {"name": name, "photos": int(counts[row]), **_camera(network, row)}
            for row, name in enumerate(network.cameras.names)
        ]
    }


def _nominal(groups: list[Group]) -> list[float]:
    return [float(np.nan if group.assumed else group.focal_px or np.nan) for group in groups]


def _observations(
    network: Network, names: list[str], shifts: Mapping[int, Array]
) -> list[dict[str, Any]]:
    residuals = network.solution.residuals["rays"]
    seen = [(s.center_px - shifts[s.photo]).tolist() for s in network.sightings]
    return [
        {
            "file": names[s.photo], "name": name_of(s.point), "col_px": seen[i][0],
            "row_px": seen[i][1], "residual_px": residuals[i].tolist(),
            "used": bool(network.used[i]),
        }
        for i, s in enumerate(network.sightings)
    ]  # fmt: skip


def _points(network: Network, out: Delivered) -> list[dict[str, Any]]:
    rays = network.ray_counts()
    points = []
    for i, number in enumerate(out.numbers):
        own = slice(3 * i, 3 * i + 3)
        point: dict[str, Any] = {"name": name_of(number), "coded": number > 0}
        if number > 0:
            point["id"] = number
        point["xyz_mm"] = out.xyz_mm[i].tolist()
        point["covariance_mm2"] = out.covariance_mm2[own, own].tolist()
        circle = network.circles.get(number)
        if circle is not None:
            point["normal"] = (out.frame.turn @ circle.normal).tolist()
        points.append({**point, "images": rays[number]})
    return points


def _photo(
    number: int, name: str, network: Network, out: Delivered, reasons: Mapping[int, str]
) -> dict[str, Any]:
    if number not in network.photos:
        return {
            "file": name, "used": False, "reason": reasons[number], "position_mm": None,
            "euler_xyz_rad": None,
        }  # fmt: skip
    camera = network.cameras.names[network.cameras.row(number)]
    told = {"camera": camera} if len(network.cameras) > 1 else {}
    pose = network.pose(number)
    turned = out.frame.turn @ Rotation.from_rotvec(pose[:3]).as_matrix().T
    euler = [float(angle) for angle in euler_xyz_rad_from_rotation(turned)]
    place = out.frame.moved(pose[None, 3:])[0].tolist()
    return {
        "file": name, "used": True, "reason": None, "position_mm": place, "euler_xyz_rad": euler,
        **told,
    }  # fmt: skip


def measured_bars(
    network: Network, bars: tuple[DeclaredBar, ...], what: str, findings: list[str]
) -> list[dict[str, Any]]:
    """Return the lengths of bars; what must be told of them is added to the findings.

    ``what`` is "scale bar" or "check bar", of which only the latter checks anything.
    """
    entries = []
    for bar in bars:
        if not all(end in network.points for end in bar.ends):
            findings.append(
                f"The {what} {bar.ends[0]}-{bar.ends[1]} could not be measured: its ends are not"
                f" both seen in {FEWEST_RAYS} photographs."
            )
            continue
        measured, sigma = network.length(bar.ends)
        off, all_sigma = measured - bar.length_mm, np.hypot(sigma, bar.sigma_mm)
        if what == "check bar" and abs(off) > _CHECK_SIGMAS * all_sigma:
            findings.append(
                f"The check bar {bar.ends[0]}-{bar.ends[1]} comes out {off:+.4f} mm off its length,"
                f" {abs(off) / all_sigma:.1f} sigma: the scale may be wrong, or this bar's length"
                " or the numbers of its ends."
            )
        entries.append(
            {
                "ends": list(bar.ends), "length_mm": bar.length_mm, "measured_mm": measured,
                "sigma_mm": sigma,
            }
        )  # fmt: skip
    return entries


def write_points(path: Path, result: SurveyResult) -> None:
    """Write points.json, and the full covariance of its points (mm²) beside it.

    Raises
    ------
    InputError
        Where a file cannot be written.
    """
    buffer = io.BytesIO()
    np.save(buffer, result.delivered.covariance_mm2)
    beside = path.with_name(f"{path.stem}_covariance.npy")
    write_whole(beside, buffer.getvalue())
    diameters = result.network.diameters_mm
    content = {
        "target_family": result.given.target_family,
        "coded_dot_diameter_mm": diameters.get(CODED),
        "plain_dot_diameter_mm": diameters.get(PLAIN),
        "points": result.json["points"],
        "full_covariance": {
            "file": beside.name,
            "order": [point["name"] for point in result.json["points"]],
        },
    }
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
