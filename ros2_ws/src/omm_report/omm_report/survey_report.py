"""A survey as a document: the network, its residuals, its points, what to do where it is weak."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omm_report.document import Document
from omm_report.survey_text import survey_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_CODED, _PLAIN, _CAMERA = "#1f5fa8", "#d1720f", "#777777"
_MOST_NAMES = 50  # of photographs that are legible below one picture


def survey_document(result: dict[str, Any], source: str) -> bytes:
    """Return the PDF of a survey.

    Parameters
    ----------
    result : dict
        In the form of ``survey --json``.
    source : str
        The set, as people named it.
    """
    document = Document("Survey of targets")
    findings = result["findings"]
    document.paragraph(f"From {source}.\n" + survey_text({**result, "findings": []}))
    for words in findings:
        document.paragraph(f"Finding: {words}")
    document.heading("Network")
    document.figure(
        network_figure(result),
        caption="Targets with their error ellipsoids (enlarged), and where photographs were taken.",
    )
    document.heading("Lengths")
    document.table(_bar_rows(result))
    if result.get("acceptance"):
        document.heading("Acceptance by lengths (VDI/VDE 2634-1)")
        document.figure(
            acceptance_figure(result["acceptance"]), width_mm=140.0,
            caption="Errors with 2 sigma; red: the limit.",
        )  # fmt: skip
        document.table(_length_rows(result["acceptance"]))
    if result.get("observations"):
        document.heading("Residuals")
        document.figure(residual_figure(result), caption="Measured minus computed, enlarged.")
        document.figure(per_photo_figure(result))
    document.heading("Rays of each target")
    document.figure(rays_figure(result), width_mm=120.0)
    for camera in result.get("cameras") or [{"name": "", **result["camera"]}]:
        document.heading(f"Camera {camera['name']}".strip())
        document.table(_camera_rows(camera))
    document.heading("Coordinates")
    document.table(_point_rows(result["points"]), widths=(10, 16, 16, 16, 11, 11, 11, 9))
    document.heading("Photographs")
    document.table(_photo_rows(result["photos"]), widths=(30, 50, 20))
    document.attach(
        "survey.json",
        json.dumps(result, allow_nan=False).encode(),
        description="the result as written by --json",
        mime_type="application/json",
    )
    return document.to_bytes()


def _places(entries: list[dict[str, Any]], key: str) -> Array:
    return np.array([entry[key] for entry in entries if entry[key] is not None]).reshape(-1, 3)


def network_figure(result: dict[str, Any]) -> Figure:
    """Return a view of the network in space."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    points = result["points"]
    xyz = _places(points, "xyz_mm")
    coded = np.array([point["coded"] for point in points], dtype=bool)
    for chosen, colour, label in ((coded, _CODED, "coded"), (~coded, _PLAIN, "plain")):
        if chosen.any():
            axes.scatter(*xyz[chosen].T, s=8, color=colour, label=label, depthshade=False)
    places = _places(result["photos"], "position_mm")
    if len(places):
        axes.scatter(*places.T, s=14, marker="^", color=_CAMERA, label="camera", depthshade=False)
    covariances = np.array([point["covariance_mm2"] for point in points])
    size = float(np.ptp(xyz, axis=0).max())
    largest = np.sqrt(max(float(np.linalg.eigvalsh(covariances)[:, 2].max()), 1e-18))
    enlarged = 0.06 * size / largest
    for place, covariance in zip(xyz, covariances, strict=True):
        axes.plot_wireframe(*_ellipsoid(place, covariance, enlarged), color="#a33", linewidth=0.25)
    axes.set_title(f"ellipsoids (1 sigma) enlarged {enlarged:.0f} times", fontsize=8)
    axes.set_aspect("equal")
    for name, set_label in (("x", axes.set_xlabel), ("y", axes.set_ylabel), ("z", axes.set_zlabel)):
        set_label(f"{name}, mm", fontsize=7)
    axes.tick_params(labelsize=6)
    axes.legend(fontsize=7, loc="upper left")
    return figure


def _ellipsoid(place: Array, covariance: Array, enlarged: float) -> tuple[Array, Array, Array]:
    values, vectors = np.linalg.eigh(covariance)
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, 9), np.linspace(0, np.pi, 5))
    ball = np.stack([np.cos(around) * np.sin(up), np.sin(around) * np.sin(up), np.cos(up)], axis=-1)
    shaped = place + enlarged * (ball * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    x, y, z = np.moveaxis(shaped, -1, 0)
    return x, y, z


def residual_figure(result: dict[str, Any]) -> Figure:
    """Return all residuals over the picture."""
    from matplotlib.figure import Figure

    used = [o for o in result["observations"] if o["used"]]
    at = np.array([[o["col_px"], o["row_px"]] for o in used])
    residual = np.array([o["residual_px"] for o in used])
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    axes = figure.subplots()
    rms = max(float(np.sqrt(np.mean(residual**2))), 1e-9)
    scale = rms / (0.015 * max(float(np.ptp(at[:, 0])), 1.0))
    arrows = axes.quiver(
        *at.T, *residual.T, angles="xy", scale_units="xy", scale=scale, width=0.001
    )
    axes.set_title("residuals, enlarged", fontsize=9)  # also makes room for the key beside it
    axes.quiverkey(arrows, 0.8, 1.03, rms, f"{rms:.4f} px (rms)", labelpos="E")
    axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.set_xlabel("col, px")
    axes.set_ylabel("row, px")
    return figure


def per_photo_figure(result: dict[str, Any]) -> Figure:
    """Return the rms of the residuals of each photograph, and how many rays it has."""
    from matplotlib.figure import Figure

    names = [photo["file"] for photo in result["photos"] if photo["used"]]
    squares: dict[str, list[float]] = {name: [] for name in names}
    for o in result["observations"]:
        if o["used"]:
            squares[o["file"]].append(float(np.mean(np.square(o["residual_px"]))))
    rms = [float(np.sqrt(np.mean(squares[name]))) if squares[name] else 0.0 for name in names]
    figure = Figure(figsize=(7, 2.4), layout="constrained")
    axes = figure.subplots()
    axes.bar(range(len(names)), rms, color=_CODED)
    axes.set_ylabel("rms, px", fontsize=8)
    step = -(-len(names) // _MOST_NAMES)
    axes.set_title(
        "residuals by photograph" + (" (number of rays above)" if step == 1 else ""), fontsize=8
    )
    for i, name in enumerate(names if step == 1 else ()):
        axes.text(i, rms[i], str(len(squares[name])), ha="center", va="bottom", fontsize=5)
    told = range(0, len(names), max(step, 1))
    axes.set_xticks(told, [names[i].rsplit(".", 1)[0][-12:] for i in told], rotation=90)
    axes.tick_params(labelsize=5)
    return figure


def acceptance_figure(acceptance: dict[str, Any]) -> Figure:
    """Return length errors over calibrated lengths, with their limit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 2.8), layout="constrained")
    axes = figure.subplots()
    length = np.array([entry["length_mm"] for entry in acceptance["lengths"]])
    error = np.array([entry["error_mm"] for entry in acceptance["lengths"]])
    sigma = np.array([entry["sigma_mm"] for entry in acceptance["lengths"]])
    axes.errorbar(length, error, yerr=2 * sigma, fmt="o", markersize=3, color=_CODED, capsize=2)
    along = np.array([0.0, 1.05 * length.max()])
    limit = acceptance["LME"]["constant_mm"] + acceptance["LME"]["per_metre_mm"] * along / 1e3
    for sign in (-1.0, 1.0):
        axes.plot(along, sign * limit, color="#a33")
    axes.set_xlabel("calibrated length, mm", fontsize=8)
    axes.set_ylabel("measured minus calibrated, mm", fontsize=8)
    axes.tick_params(labelsize=7)
    return figure


def rays_figure(result: dict[str, Any]) -> Figure:
    """Return how many targets are seen how often."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(5, 2.2), layout="constrained")
    axes = figure.subplots()
    counts = [[p["images"] for p in result["points"] if p["coded"] == coded] for coded in (1, 0)]
    most = max((max(c) for c in counts if c), default=1)
    axes.hist(
        counts, bins=np.arange(0.5, most + 1.5).tolist(), stacked=True, color=[_CODED, _PLAIN],
        label=["coded", "plain"],
    )  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("photographs that show a target", fontsize=8)
    axes.set_ylabel("targets", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=7)
    return figure


def _bar_rows(result: dict[str, Any]) -> list[list[str]]:
    rows = [["bar", "use", "length, mm", "measured, mm", "difference, mm", "σ, mm"]]
    for kind, use in (("scale_bars", "scale"), ("check_bars", "check")):
        for bar in result[kind]:
            off = bar["measured_mm"] - bar["length_mm"]
            rows.append(
                [
                    "–".join(map(str, bar["ends"])), use, f"{bar['length_mm']:.4f}",
                    f"{bar['measured_mm']:.4f}", f"{off:+.4f}", f"{bar['sigma_mm']:.4f}",
                ]
            )  # fmt: skip
    return rows


def _length_rows(acceptance: dict[str, Any]) -> list[list[str]]:
    rows = [["length", "calibrated, mm", "measured, mm", "error, mm", "σ, mm", "limit, mm"]]
    for length in acceptance["lengths"]:
        beyond = "" if length["within"] else " exceeded"
        rows.append(
            [
                "–".join(map(str, length["ends"])), f"{length['length_mm']:.4f}",
                f"{length['measured_mm']:.4f}", f"{length['error_mm']:+.4f}",
                f"{length['sigma_mm']:.4f}", f"{length['limit_mm']:.4f}{beyond}",
            ]
        )  # fmt: skip
    return rows


def _camera_rows(camera: dict[str, Any]) -> list[list[str]]:
    sigmas = np.sqrt(np.maximum(np.diag(camera["covariance"]), 0.0))
    rows = [["parameter", "value", "σ"]]
    for name, value, sigma in zip(camera["parameters"], camera["values"], sigmas, strict=True):
        rows.append([name, f"{value:.8g}", f"{sigma:.3g}" if sigma > 0 else "held"])
    return rows


def _point_rows(points: list[dict[str, Any]]) -> list[list[str]]:
    rows = [["target", "x, mm", "y, mm", "z, mm", "σ x", "σ y", "σ z", "rays"]]
    for point in points:
        sigmas = np.sqrt(np.diag(point["covariance_mm2"]))
        rows.append(
            [
                point["name"], *(f"{x:.4f}" for x in point["xyz_mm"]),
                *(f"{s:.4f}" for s in sigmas), str(point["images"]),
            ]
        )  # fmt: skip
    return rows


def _photo_rows(photos: list[dict[str, Any]]) -> list[list[str]]:
    rows = [["photograph", "left out because", "from, mm"]]
    for photo in photos:
        place = photo["position_mm"]
        told = "" if place is None else ", ".join(f"{x:.0f}" for x in place)
        rows.append([photo["file"], photo["reason"] or "", told])
    return rows
