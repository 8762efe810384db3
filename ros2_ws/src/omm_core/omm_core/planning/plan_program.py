"""The program of a plan, and its look from afar where the part may lie anywhere near."""

from __future__ import annotations

from collections.abc import Mapping

from omm_core.errors import InputError
from omm_core.planning.plan import Plan
from omm_core.planning.program import Program, ProgramOptions, ProgramStop, make_program
from omm_core.planning.tour import beyond_the_part, retracted

RETRACT_MM = 100.0
TRIES = 40
TRIES_OF_A_SEARCH = 900


def plan_program(plan: Plan, *, limit_mm: float, search: bool = False) -> Program:
    """Return the program of a plan.

    Parameters
    ----------
    limit_mm : float
        Largest correction of a stop that the program takes.
    search : bool
        The part may lie as far away: a first image is taken from so far back that the camera
        cannot meet it, and where it shows nothing the program looks around.

    Raises
    ------
    InputError
        Where an axis does not reach the place of that first image.
    """
    stops: list[ProgramStop] = []
    if search:
        look = look_from_afar(plan, limit_mm)
        stops.append(ProgramStop(axes=look, label="look from afar", look=True))
    for i, stop in enumerate(plan.stops):
        through = plan.legs[i - 1].through if i else ()
        stops.append(
            ProgramStop(
                axes=stop.axes,
                label="target " + " ".join(str(target) for target in stop.target_ids),
                leave=through[:1],
                arrive=through[1:],
            )
        )
    options = ProgramOptions(
        retract_mm=RETRACT_MM,
        dwell_s=plan.pace.settling_s,
        feed_mm_per_min=60.0 * plan.pace.feed_mm_per_s,
        limit_mm=limit_mm,
        tries=TRIES_OF_A_SEARCH if search else TRIES,
    )
    return make_program(
        plan.scene.kinematics,
        stops,
        options,
        title=plan.scene.part.name,
        free=lambda axes, name: beyond_the_part(plan.scene, axes, name),
    )


def look_from_afar(plan: Plan, distance_mm: float) -> Mapping[str, float]:
    """Return the first stop, back along the spindle's axis as far as the part may be nearer."""
    axes = retracted(plan.scene, plan.stops[0].axes, distance_mm)
    if axes is None:
        raise InputError(
            f"Expected room to begin {distance_mm:g} mm back from the first stop, but an axis does"
            f" not reach there. Search less far (--search), or allow more travel."
        )
    return {name: (v if name in plan.scene.kinematics.rotary else round(v, 3) + 0.0)
            for name, v in axes.items()}  # fmt: skip
