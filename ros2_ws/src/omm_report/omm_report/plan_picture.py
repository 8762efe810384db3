"""A plan as a picture: the part from above and from the side, the stops, what each looks at."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omm_core.files.output import write_whole
from omm_core.planning.plan import Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_CLOSE = 0.035  # of the part: labels nearer than that would lie on each other
# Corners of the box differ in one of three bits along an edge.
_EDGES = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]


def plan_figure(plan: Plan) -> Figure:
    """Return the picture: x and y of the machine, and the longer of the two with z."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.5), layout="constrained")
    above, side = figure.subplots(1, 2)
    _view(above, plan, 0, 1)
    spread = np.ptp(plan.scene.targets_in_machine(), axis=0)
    _view(side, plan, 0 if spread[0] >= spread[1] else 1, 2)
    figure.suptitle(
        f"{plan.scene.part.name}: {len(plan.stops)} images, {plan.seconds:.0f} s,"
        f" U of the worst corner {plan.corner_U_mm.max():.3f} mm"
    )
    return figure


def save_plan_picture(plan: Plan, path: Path) -> None:
    """Write the picture as PNG."""
    buffer = io.BytesIO()
    plan_figure(plan).savefig(buffer, format="png", dpi=110, metadata={"Software": "omm"})
    write_whole(path, buffer.getvalue())


def together(
    places: Array, words: Sequence[str], near: float
) -> list[tuple[tuple[float, float], str]]:
    """Return labels for places (N, 2); those that lie nearer than ``near`` share one."""
    labels: list[tuple[Array, list[str]]] = []
    for place, word in zip(places, words):
        at = next((said for there, said in labels if np.linalg.norm(there - place) < near), None)
        if at is None:
            labels.append((place, [word]))
        else:
            at.append(word)
    return [((float(at[0]), float(at[1])), ", ".join(said)) for at, said in labels]


def _view(axes: Axes, plan: Plan, across: int, up: int) -> None:
    scene, pick = plan.scene, [across, up]
    corners = (scene.machine_T_part @ scene.part.box_corners())[:, pick]
    for a, b in _EDGES:
        axes.plot(*corners[[a, b]].T, color="0.6", linewidth=1)
    targets = scene.targets_in_machine()[:, pick]
    axes.plot(*targets.T, "s", color="tab:blue", label="targets")
    ids = [target.id for target in scene.part.targets]
    near = _CLOSE * float(np.ptp(np.vstack([corners, targets]), axis=0).max())
    for place, words in together(targets, [str(target) for target in ids], near):
        axes.annotate(words, place, xytext=(5, -11), textcoords="offset points", fontsize=8)
    cameras = []
    for stop in plan.stops:
        camera = (stop.machine_T_spindle @ scene.spindle_T_camera).translation_mm[pick]
        cameras.append(camera)
        for target in stop.target_ids:
            axes.plot(*np.array([camera, targets[ids.index(target)]]).T, color="tab:orange", lw=0.7)
    axes.plot(*np.array(cameras).T, "o-", color="tab:red", lw=0.5, markersize=5, label="camera")
    numbers = [str(number) for number in range(1, len(cameras) + 1)]
    for place, words in together(np.array(cameras), numbers, near):
        axes.annotate(
            words, place, xytext=(4, 5), textcoords="offset points", fontsize=8, color="tab:red"
        )
    names = "xyz"
    axes.set(xlabel=f"{names[across]} mm (machine)", ylabel=f"{names[up]} mm (machine)")
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize=8)
