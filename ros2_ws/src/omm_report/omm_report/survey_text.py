"""A survey's result as a few lines that a person reads."""

from __future__ import annotations

from typing import Any

import numpy as np


def survey_text(result: dict[str, Any]) -> str:
    """Return the lines for a result in the form of ``survey --json``."""
    points = result["points"]
    used = sum(photo["used"] for photo in result["photos"])
    coded = sum(point["coded"] for point in points)
    residuals = (
        f"{result['rms_px']:.4f} px rms"
        if result["rms_px"] is not None
        else f"{result['rms_mm'] * 1000:.3f} um rms"
    )
    kinds = {} if "cameras" in result else result.get("sigma0_by", {})
    by_kind = f" ({', '.join(f'{k} {s:.3f}' for k, s in kinds.items())})" if kinds else ""
    lines = [
        f"{coded} coded and {len(points) - coded} plain targets from {used} of"
        f" {len(result['photos'])} photographs",
        f"residuals {residuals}, {result['sigma0']:.3f} times what was expected{by_kind};"
        f" {result['degrees_of_freedom']} degrees of freedom",
    ]
    if points:
        sigma = np.sqrt([np.diag(point["covariance_mm2"]) for point in points])
        middle, worst = np.median(sigma, axis=0), int(np.argmax(sigma.max(axis=1)))
        lines.append(
            "standard deviations x, y, z (median): "
            + ", ".join(f"{s:.4f}" for s in middle)
            + f" mm; largest {sigma[worst].max():.4f} mm at {points[worst]['name']}"
        )
    lines += [_camera_line(camera, result["sigma0_by"]) for camera in result.get("cameras", ())]
    for kind in ("scale_bars", "check_bars"):
        for bar in result[kind]:
            off = bar["measured_mm"] - bar["length_mm"]
            lines.append(
                f"{kind[:-5]} bar {bar['ends'][0]}-{bar['ends'][1]}: {bar['measured_mm']:.4f} mm,"
                f" {off:+.4f} against its length (sigma {bar['sigma_mm']:.4f})"
            )
    return "\n".join(lines + result["findings"])


def _camera_line(camera: dict[str, Any], sigma0_by: dict[str, float]) -> str:
    sigma = float(np.sqrt(max(camera["covariance"][0][0], 0.0)))
    noise = ", ".join(
        f"{kind.removesuffix(', ' + camera['name'])} {sigma0:.3f}"
        for kind, sigma0 in sigma0_by.items()
        if kind.endswith(f", {camera['name']}")
    )
    return (
        f"{camera['name']}: {camera['photos']} photographs, f {camera['values'][0]:.2f} px (sigma"
        f" {sigma:.2f}); times what was expected: {noise}"
    )
