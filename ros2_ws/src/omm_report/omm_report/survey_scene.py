"""A survey as a scene in space that any browser opens: one HTML file, nothing to be loaded."""

from __future__ import annotations

import html
import json
from typing import Any

import numpy as np

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>__TITLE__</title>
<style>body{margin:0;font:14px sans-serif;background:#fff;color:#222}
canvas{display:block;width:100vw;height:100vh;touch-action:none}
#legend{position:fixed;left:12px;top:10px;background:#ffffffd8;padding:6px 10px}</style></head>
<body><canvas id="view" aria-label="Targets and photographs in space"></canvas>
<div id="legend"><b>__TITLE__</b><br>Drag turns, wheel zooms.
Blue: coded, orange: plain targets; grey: photographs.
Red: standard deviations, enlarged <span id="scale"></span> times.</div>
<script>
const data = __DATA__;
const canvas = document.getElementById("view"), ctx = canvas.getContext("2d");
document.getElementById("scale").textContent = data.enlarged.toFixed(0);
let turn = 0.6, tilt = 0.5, zoom = 1;
function project(p) {
  const x = p[0] - data.middle[0], y = p[1] - data.middle[1], z = p[2] - data.middle[2];
  const a = x * Math.cos(turn) - y * Math.sin(turn), b = x * Math.sin(turn) + y * Math.cos(turn);
  const up = z * Math.cos(tilt) + b * Math.sin(tilt);
  const s = zoom * 0.42 * Math.min(canvas.width, canvas.height) / data.radius;
  return [canvas.width / 2 + s * a, canvas.height / 2 - s * up];
}
function line(p, q) {
  ctx.beginPath(); ctx.moveTo(...project(p)); ctx.lineTo(...project(q)); ctx.stroke();
}
function dot(p, r) {
  const [x, y] = project(p);
  ctx.beginPath(); ctx.arc(x, y, r, 0, 7); ctx.fill();
  return [x, y];
}
function draw() {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = innerWidth * ratio; canvas.height = innerHeight * ratio;
  ctx.font = 11 * ratio + "px sans-serif";
  ctx.strokeStyle = "#999"; ctx.fillStyle = "#777"; ctx.lineWidth = ratio;
  for (const c of data.photos) { for (const e of c.corners) line(c.at, e);
    for (let i = 0; i < 4; i++) line(c.corners[i], c.corners[(i + 1) % 4]); }
  ctx.strokeStyle = "#c22";
  for (const p of data.points) for (const a of p.axes)
    line(p.at.map((v, i) => v - a[i]), p.at.map((v, i) => v + a[i]));
  for (const p of data.points) {
    ctx.fillStyle = p.coded ? "#1f5fa8" : "#d1720f";
    const [x, y] = dot(p.at, 3 * ratio);
    ctx.fillText(p.name, x + 5 * ratio, y - 4 * ratio);
  }
}
canvas.addEventListener("pointermove", e => { if (e.buttons) {
  turn += e.movementX * 0.006;
  tilt = Math.max(-1.57, Math.min(1.57, tilt + e.movementY * 0.006));
  draw();
} });
canvas.addEventListener("wheel", e => {
  e.preventDefault(); zoom *= Math.exp(-e.deltaY * 0.001); draw();
}, { passive: false });
addEventListener("resize", draw); draw();
</script></body></html>
"""

_CORNERS = np.array([[-1, -0.7, 1.5], [1, -0.7, 1.5], [1, 0.7, 1.5], [-1, 0.7, 1.5]])


def survey_scene(result: dict[str, Any], title: str) -> str:
    """Return the page for a result in the form of ``survey --json``."""
    from scipy.spatial.transform import Rotation

    points = result["points"]
    xyz = np.array([point["xyz_mm"] for point in points])
    size = float(np.ptp(xyz, axis=0).max())
    covariances = np.array([point["covariance_mm2"] for point in points])
    values, vectors = np.linalg.eigh(covariances)
    enlarged = 0.06 * size / float(np.sqrt(max(values.max(), 1e-18)))
    axes = enlarged * np.sqrt(np.maximum(values, 0.0))[:, None, :] * vectors
    photos = []
    for photo in result["photos"]:
        if photo["position_mm"] is None:
            continue
        turned = Rotation.from_euler("xyz", photo["euler_xyz_rad"])
        frame = (
            0.06 * size * np.array([[-1, -0.7, 1.5], [1, -0.7, 1.5], [1, 0.7, 1.5], [-1, 0.7, 1.5]])
        )
        at = np.array(photo["position_mm"])
        photos.append({"at": at.tolist(), "corners": (at + turned.apply(frame)).tolist()})
    every = np.vstack([xyz, *[np.array(p["at"])[None] for p in photos]])
    middle = xyz.mean(axis=0)
    data = {
        "points": [
            {
                "name": point["name"], "coded": point["coded"], "at": place.tolist(),
                "axes": axis.T.tolist(),
            }
            for point, place, axis in zip(points, xyz, axes, strict=True)
        ],
        "photos": photos,
        "middle": middle.tolist(),
        "radius": float(np.linalg.norm(every - middle, axis=1).max()),
        "enlarged": enlarged,
    }  # fmt: skip
    text = json.dumps(data, allow_nan=False).replace("</", "<\\/")
    return _PAGE.replace("__TITLE__", html.escape(title)).replace("__DATA__", text)
