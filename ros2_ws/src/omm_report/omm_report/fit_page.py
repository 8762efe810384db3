"""A fit as a page in three dimensions: one file, no internet, opens in any browser."""

from __future__ import annotations

import base64
import html
import json
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from omm_core.overstock.fit import Fit
from omm_report.fit_map import map_of_fit
from omm_report.fit_picture import COLOURS, GREY, colour_range
from omm_report.fit_report import group_rows, verdict_words

Array = NDArray[np.float64]


def fit_page(fit: Fit) -> str:
    """Return the page: the part coloured by overstock, its points, and the table of faces."""
    drawn = map_of_fit(fit)
    low, high = colour_range(drawn)
    middle = 0.5 * (drawn.corners.max(axis=(0, 1)) + drawn.corners.min(axis=(0, 1)))
    size = float(np.linalg.norm(drawn.corners.max(axis=(0, 1)) - drawn.corners.min(axis=(0, 1))))
    groups = [entry["group"] for entry in fit.document["points"]]
    content = {
        "corners": _packed((drawn.corners - middle).reshape(-1) / size),
        "normals": _packed(np.repeat(drawn.normals, 3, axis=0).reshape(-1)),
        "colours": _packed(_colours(drawn.values.reshape(-1), low, high).reshape(-1)),
        "points": _packed((drawn.points - middle).reshape(-1) / size),
        "pointColours": _packed(_colours(drawn.point_values, low, high).reshape(-1)),
        "labels": [
            f"{name}: {value:.3f} mm ({group})"
            for name, value, group in zip(drawn.point_names, drawn.point_values, groups)
        ],
    }
    stops = [_css(colormaps[COLOURS](v)[:3]) for v in np.linspace(1.0, 0.0, 9)]
    rows = group_rows(fit.document["groups"])
    return (
        _PAGE.replace("@TITLE@", html.escape(f"Fit of {fit.problem.file.cad.name}"))
        .replace("@VERDICT@", html.escape(verdict_words(fit.document)))
        .replace("@TABLE@", _table(rows))
        .replace("@FINDINGS@", "".join(_item(words) for words in fit.document["findings"]))
        .replace("@STOPS@", ", ".join(stops))
        .replace("@LOW@", f"{low:.2f}")
        .replace("@HIGH@", f"{high:.2f}")
        .replace("@CONTENT@", _safe(content))
    )


def _packed(values: Array) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _colours(values: Array, low: float, high: float) -> Array:
    share = np.clip((np.nan_to_num(values) - low) / (high - low), 0.0, 1.0)
    colours = colormaps[COLOURS](share)[:, :3]
    colours[np.isnan(values)] = GREY
    return np.asarray(colours)


def _css(colour: Any) -> str:
    return "#" + "".join(f"{round(255 * float(v)):02x}" for v in colour)


def _safe(content: dict[str, Any]) -> str:
    """Return JSON that cannot end the script it stands in, whatever points are called."""
    return json.dumps(content, allow_nan=False).replace("<", "\\u003c")


def _item(words: str) -> str:
    return f"<li>{html.escape(words)}</li>"


def _table(rows: list[list[str]]) -> str:
    head = "".join(f"<th scope='col'>{html.escape(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in rows[1:]
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>@TITLE@</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body { font: 15px/1.45 system-ui, sans-serif; margin: 0; color: #1a1a1a; background: #fff }
main { display: flex; flex-wrap: wrap; gap: 1rem; padding: 1rem }
#view { position: relative; flex: 1 1 34rem; min-height: 26rem; height: 75vh }
canvas { width: 100%; height: 100%; background: #eef0f3; touch-action: none; cursor: grab }
#legend { position: absolute; right: .7rem; top: .7rem; width: 1.1rem; height: 12rem;
  background: linear-gradient(@STOPS@); border: 1px solid #555 }
#legend span { position: absolute; right: 1.5rem; white-space: nowrap; background: #eef0f3cc }
#told { position: absolute; left: .7rem; bottom: .7rem; background: #fffd; padding: .2rem .5rem }
section { flex: 1 1 26rem; overflow-x: auto }
table { border-collapse: collapse; font-size: 13px }
th, td { text-align: left; padding: .2rem .5rem; border-bottom: 1px solid #ccc }
h1 { font-size: 1.3rem; margin: 0 0 .5rem }
</style></head><body><main>
<div id="view"><canvas tabindex="0" role="img"
 aria-label="The part in three dimensions, coloured by overstock; the table says the same"></canvas>
<div id="legend" aria-hidden="true"><span style="top:-.3rem">@HIGH@ mm</span>
<span style="bottom:-.3rem">@LOW@ mm</span></div>
<div id="told" aria-live="polite">
Drag or arrow keys turn, wheel or + and − zoom; point at a dot.</div></div>
<section><h1>@TITLE@</h1><p>@VERDICT@</p>@TABLE@<ul>@FINDINGS@</ul>
<p>Overstock in mm at the measured points, foil taken off. Grey faces have no points.</p></section>
</main>
<script>
"use strict";
const given = @CONTENT@;
const unpack = text => new Float32Array(
  Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer);
const canvas = document.querySelector("canvas"), told = document.getElementById("told");
const gl = canvas.getContext("webgl");
if (!gl) told.textContent = "This browser has no WebGL; the table says the same.";
else show();
function show() {
  const program = gl.createProgram();
  const add = (type, text) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  };
  add(gl.VERTEX_SHADER, `attribute vec3 place, normal, colour; uniform mat3 turn;
    uniform float zoom, aspect; uniform mediump float lift; varying vec3 shade;
    void main() { vec3 p = turn * place * zoom; float light = .5 + .5 * abs((turn * normal).z);
      shade = colour * (lift > 0. ? 1. : light); gl_PointSize = 9.;
      gl_Position = vec4(p.x / aspect, p.y, -p.z * .2 - lift, 1.); }`);
  add(gl.FRAGMENT_SHADER, `precision mediump float; varying vec3 shade; uniform mediump float lift;
    void main() { vec2 q = gl_PointCoord - .5; float r = length(q);
      if (lift > 0. && r > .5) discard;
      gl_FragColor = vec4(lift > 0. && r > .32 ? vec3(0.) : shade, 1.); }`);
  gl.linkProgram(program); gl.useProgram(program);
  const at = name => gl.getUniformLocation(program, name);
  const buffers = {};
  for (const name of ["corners", "normals", "colours", "points", "pointColours"]) {
    buffers[name] = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, unpack(given[name]), gl.STATIC_DRAW);
  }
  const feed = (attribute, name) => {
    const place = gl.getAttribLocation(program, attribute);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.enableVertexAttribArray(place); gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
  };
  const points = unpack(given.points), count = unpack(given.corners).length / 3;
  let turned = -.6, tipped = -1.0, zoom = 1.7;
  const matrix = () => {
    const [c, s, d, t] = [Math.cos(turned), Math.sin(turned), Math.cos(tipped), Math.sin(tipped)];
    return [c, d * s, t * s, -s, d * c, t * c, 0, -t, d];
  };
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(.933, .941, .953, 1); gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix3fv(at("turn"), false, matrix());
    gl.uniform1f(at("zoom"), zoom); gl.uniform1f(at("aspect"), canvas.width / canvas.height);
    gl.uniform1f(at("lift"), 0);
    feed("place", "corners"); feed("normal", "normals"); feed("colour", "colours");
    gl.drawArrays(gl.TRIANGLES, 0, count);
    if (points.length) {
      gl.uniform1f(at("lift"), .004);
      feed("place", "points"); feed("normal", "points"); feed("colour", "pointColours");
      gl.drawArrays(gl.POINTS, 0, points.length / 3);
    }
  }
  let last = null;
  canvas.addEventListener("pointerdown", e => { last = e; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", () => { last = null; });
  canvas.addEventListener("pointermove", e => {
    if (!last) { point(e); return; }
    turned += (e.clientX - last.clientX) * .008; tipped += (e.clientY - last.clientY) * .008;
    last = e; draw();
  });
  canvas.addEventListener("wheel", e => {
    zoom *= Math.exp(-e.deltaY * .001); e.preventDefault(); draw(); }, {passive: false});
  canvas.addEventListener("keydown", e => {
    const step = {ArrowLeft: [-.1, 0], ArrowRight: [.1, 0], ArrowUp: [0, -.1], ArrowDown: [0, .1]};
    if (step[e.key]) { turned += step[e.key][0]; tipped += step[e.key][1]; }
    else if (e.key === "+") zoom *= 1.1; else if (e.key === "-") zoom /= 1.1; else return;
    e.preventDefault(); draw();
  });
  function point(e) {
    const box = canvas.getBoundingClientRect(), m = matrix(), aspect = box.width / box.height;
    let best = 14, depth = -9, found = -1;
    for (let i = 0; i < points.length / 3; i++) {
      const p = [0, 1, 2].map(r =>
        zoom * [0, 1, 2].reduce((sum, k) => sum + m[3 * k + r] * points[3 * i + k], 0));
      const x = (p[0] / aspect + 1) * box.width / 2, y = (1 - p[1]) * box.height / 2;
      const away = Math.hypot(x - (e.clientX - box.left), y - (e.clientY - box.top));
      if (away < 10 && (p[2] > depth + .02 || away < best && p[2] > depth - .02)) {
        best = away; depth = p[2]; found = i;
      }
    }
    if (found >= 0) told.textContent = given.labels[found];
  }
  new ResizeObserver(draw).observe(canvas);
  draw();
}
</script></body></html>
"""
