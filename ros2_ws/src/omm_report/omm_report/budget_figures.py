"""Pictures of budgets, campaigns and probing checks."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from omm_core.budget.box_map import BoxMap
from omm_core.budget.budget import Budget
from omm_core.budget.campaign import Campaign
from omm_core.budget.probing import COVERAGE, ProbingCheck
from omm_core.session.quantities import THETA

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_png(figure: Figure) -> bytes:
    """Return a figure as PNG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    return buffer.getvalue()


def map_figure(box_map: BoxMap) -> Figure:
    """Draw U_total along X, Y, Z over the lowest and the highest layer of the box.

    The layers lie across the box's shortest side; the cross marks the largest U of the axis.
    """
    from matplotlib.figure import Figure

    sizes = [line[-1] - line[0] for line in box_map.axes_mm]
    across = int(np.argmin(sizes))
    first, second = (axis for axis in range(3) if axis != across)
    layers = [0, -1] if sizes[across] > 0 else [0]
    figure = Figure(figsize=(10, 2.6 * len(layers) + 0.4), layout="constrained")
    plots = figure.subplots(len(layers), 3, squeeze=False)
    x, y = box_map.axes_mm[first], box_map.axes_mm[second]
    for axis, name in enumerate("XYZ"):
        values = 1e3 * box_map.expanded_mm[..., axis]
        worst, _ = box_map.worst_of_axis(axis)
        for row, layer in enumerate(layers):
            plot = plots[row, axis]
            seen = np.take(values, layer, axis=across).T
            drawn = plot.pcolormesh(
                x, y, seen, shading="gouraud" if min(seen.shape) > 1 else "nearest",
                vmin=values.min(), vmax=max(values.max(), values.min() + 1e-6),
            )  # fmt: skip
            at = box_map.axes_mm[across][layer]
            plot.set_title(f"U {name}, µm at {'xyz'[across]} = {at:g} mm", fontsize=8)
            plot.set_xlabel(f"{'xyz'[first]}, mm", fontsize=7)
            plot.set_ylabel(f"{'xyz'[second]}, mm", fontsize=7)
            plot.tick_params(labelsize=6)
            if worst[across] == at:
                plot.plot(worst[first], worst[second], "x", color="red", clip_on=False)
            figure.colorbar(drawn, ax=plot).ax.tick_params(labelsize=6)
    return figure


def shares_figure(budget: Budget) -> Figure:
    """Draw the parts of the variance at the worst point's worst axis."""
    from matplotlib.figure import Figure

    shares = budget.shares()
    figure = Figure(figsize=(7, 0.5 + 0.3 * len(shares)), layout="constrained")
    plot = figure.subplots()
    names = list(shares)[::-1]
    plot.barh(names, [100 * shares[name] for name in names], color="tab:blue")
    plot.set_xlabel(
        f"part of the variance, %, at {budget.points[budget.worst[0]].name},"
        f" {'XYZ'[budget.worst[1]]}",
        fontsize=8,
    )
    plot.tick_params(labelsize=8)
    return figure


def campaign_figure(campaign: Campaign) -> Figure:
    """Draw each quantity by clamping, about its mean, with ± 2 predicted σ."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6.1), layout="constrained")
    plots = figure.subplots(4, 2, sharex=True).ravel()
    numbers = {c: i for i, c in enumerate(sorted({m.clamping for m in campaign.measured}), 1)}
    at = [numbers[m.clamping] for m in campaign.measured]
    for index, (plot, one) in enumerate(zip(plots, THETA)):
        values = np.array([m.theta[index] for m in campaign.measured])
        if all(m.truth is not None for m in campaign.measured):
            values = values - [m.truth[index] for m in campaign.measured if m.truth is not None]
        else:
            values = values - values.mean()
        limit = 2.0 * campaign.quantities[index].predicted * one.scale
        plot.axhspan(-limit, limit, color="tab:green", alpha=0.15)
        plot.plot(at, values * one.scale, ".", markersize=3)
        plot.set_ylabel(f"{one.symbol}, {one.unit}", fontsize=8)
        plot.xaxis.get_major_locator().set_params(integer=True)
        plot.tick_params(labelsize=7)
    # The last of eight is empty: the one above it carries the axis.
    for plot in plots[-3:-1]:
        plot.set_xlabel("clamping", fontsize=8)
        plot.tick_params(labelbottom=True)
    plots[-1].set_axis_off()
    known = all(m.truth is not None for m in campaign.measured)
    what = "errors" if known else "deviations from the mean"
    figure.suptitle(f"{what}, each measurement; band: ± 2 σ as predicted", fontsize=9)
    return figure


def probing_figure(check: ProbingCheck) -> Figure:
    """Draw the error of each touch with its U, by axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    at = np.arange(len(check.points))
    for axis, plot in enumerate(figure.subplots(3, 1, sharex=True)):
        half = 1e3 * COVERAGE * check.sigma_mm[:, axis]
        error = 1e3 * check.error_mm[:, axis]
        plot.errorbar(at, np.zeros(len(at)), yerr=half, fmt="none", color="0.6", capsize=3)
        for inside, colour in ((True, "tab:blue"), (False, "tab:red")):
            chosen = check.inside[:, axis] == inside
            plot.plot(at[chosen], error[chosen], "o", color=colour, markersize=4)
        plot.axhline(0.0, color="0.8", linewidth=0.8)
        plot.set_ylabel(f"{'XYZ'[axis]}, µm", fontsize=8)
        plot.tick_params(labelsize=7)
    plot.set_xticks(*_labels([point.name for point in check.points]), rotation=90, fontsize=8)
    return figure


def _labels(names: Sequence[str]) -> tuple[list[int], list[str]]:
    step = max(1, -(-len(names) // 40))
    return list(range(0, len(names), step)), list(names[::step])
