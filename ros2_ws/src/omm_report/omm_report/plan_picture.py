"""A plan as a picture: the part from above and from the side, the stops, what each looks at."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from omm_core.files.output import write_whole
from omm_core.planning.plan import Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def _view(axes: Axes, plan: Plan, across: int, up: int) -> None:
    scene, pick = plan.scene, [across, up]
    corners = (scene.machine_T_part @ scene.part.box_corners())[:, pick]
    for a, b in _EDGES:
        axes.plot(*corners[[a, b]].T, color="0.6", linewidth=1)
    targets = scene.targets_in_machine()[:, pick]
    axes.plot(*targets.T, "s", color="tab:blue", label="targets")
    ids = [target.id for target in scene.part.targets]
    for target, place in zip(ids, targets):
        axes.annotate(str(target), place, xytext=(4, 4), textcoords="offset points")
    cameras = []
    for stop in plan.stops:
        camera = (stop.machine_T_spindle @ scene.spindle_T_camera).translation_mm[pick]
        cameras.append(camera)
        for target in stop.target_ids:
            axes.plot(*np.array([camera, targets[ids.index(target)]]).T, color="tab:orange", lw=0.7)
    axes.plot(*np.array(cameras).T, "o-", color="tab:red", lw=0.5, markersize=5, label="camera")
    for number, camera in enumerate(cameras, start=1):
        axes.annotate(str(number), camera, xytext=(4, -10), textcoords="offset points", fontsize=8)
    names = "xyz"
    axes.set(xlabel=f"{names[across]} mm (machine)", ylabel=f"{names[up]} mm (machine)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize=8)
