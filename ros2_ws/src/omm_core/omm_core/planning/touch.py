"""A touch-probe cycle at the end of a program: the height of one target's dot.

The camera is in the spindle when the images are done, so nothing is touched until somebody has put
a probe there and written its length into the program: as written, the length is 0 and the cycle is
passed over. Then: across where the images ended, far out; stop, for whoever looks; down to
``CLEARANCE_MM`` above the dot; stop again; touch, back off, touch slowly; out again.

LinuxCNC probes in the coordinates that are active (there is no G53 G38.2): what lies between these
and the machine's, offsets and tool length, is read from the control (``#<_abs_z>``, ``#<_z>``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from omm_core.geometry import RigidTransform
from omm_core.machine.kinematics import Kinematics

CLEARANCE_MM = 10.0  # above the dot, and the search below it: plates are laid so exactly by hand
_BACK_MM = 2.0
_APPROACH, _FAST, _SLOW = 1000, 150, 30  # mm/min
_UPRIGHT = 1e-9  # 1 - cosine between the spindle's and the machine's axes

# How others touch a face: their own cycle, to be called by hand.
OWN_CYCLE = {
    "siemens": "CYCLE978, measure a face along Z",
    "heidenhain": "TCH PROBE 427, measure a coordinate, axis Z",
    "fanuc": "the probe maker's cycle for one face, or G31",
    "fagor": "the cycle for probing a face, or G100",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Touch:
    """Where to touch.

    Attributes
    ----------
    beside : mapping
        Linear axes across the tool, mm: the spindle stands above the dot.
    axis, at : str, float
        The axis along the tool, and where it stands when the spindle's nose is at the dot, mm.
    outward : float
        +1 where larger values of the axis are farther up, else -1.
    lower, upper : float
        The axis' limits, mm.
    z_mm, sigma_mm : float
        The dot's planned height in the machine, and the sigma of a touch.
    """

    target: int
    beside: Mapping[str, float]
    axis: str
    at: float
    outward: float
    lower: float
    upper: float
    z_mm: float
    sigma_mm: float


def touch_at(
    kinematics: Kinematics,
    rotary: Mapping[str, float],
    axis: str,
    place_mm: np.ndarray,
    target: int,
    sigma_mm: float,
) -> Touch | None:
    """Return the touch of a place (3,), machine coordinates, with the rotary axes as they are.

    None where the spindle is not upright there, the axis along it does not move it straight up, or
    the place is beyond the limits of the axes across.
    """
    place = np.asarray(place_mm, dtype=float)
    axes = kinematics.axes_at_tool_point(rotary, place, 0.0, turns_with_part=True)
    start = kinematics.machine_T_spindle(axes)
    moved = kinematics.machine_T_spindle({**axes, axis: axes[axis] + 1.0})
    step = moved.translation_mm - start.translation_mm
    if not _upright(start) or abs(abs(step[2]) - 1.0) > _UPRIGHT:
        return None
    limits = {a.name: (a.lower, a.upper) for a in kinematics.axes}
    beside = {n: v for n, v in axes.items() if n != axis and n not in kinematics.rotary}
    if any(not limits[name][0] <= value <= limits[name][1] for name, value in beside.items()):
        return None
    lower, upper = limits[axis]
    return Touch(
        target=target,
        beside=beside,
        axis=axis,
        at=axes[axis],
        outward=float(np.sign(step[2])),
        lower=lower,
        upper=upper,
        z_mm=float(place[2]),
        sigma_mm=sigma_mm,
    )


def _upright(pose: RigidTransform) -> bool:
    return bool(pose.rotation[2, 2] > 1.0 - _UPRIGHT)


def linuxcnc_touch(touch: Touch, away: float) -> list[str]:
    """Return the cycle in LinuxCNC's words; ``away`` is where the axis stands after the images."""
    name, sign = touch.axis, touch.outward
    letter = name.lower()
    up = "+" if sign > 0.0 else "-"
    down = "-" if sign > 0.0 else "+"
    # Tip at the clearance above the dot, and at the end of the search, with the probe's length.
    above = f"[{touch.at:.4f} {up} #<_omm_probe_mm> {up} {CLEARANCE_MM:g}]"
    below = f"[{touch.at:.4f} {up} #<_omm_probe_mm> {down} {CLEARANCE_MM:g}]"
    too_long = f"[{above} {'GT' if sign > 0.0 else 'LT'} {away:.4f}]"
    edge = touch.lower if sign > 0.0 else touch.upper
    too_short = f"[{below} {'LT' if sign > 0.0 else 'GT'} {edge:.4f}]"
    across = " ".join(f"{n}{v:.4f}" for n, v in touch.beside.items())
    told = (
        f"touched: {{target: {touch.target}, z_mm: #<omm_touched>, sigma_mm: {touch.sigma_mm:g}}}"
    )
    return [
        f"(height of target {touch.target}: fill in the length of the touch probe, mm,)",
        "(from the nose of the spindle to the pole of its ball; with 0 nothing is touched)",
        "#<_omm_probe_mm> = 0",
        "O98 IF [#<_omm_probe_mm> LE 0]",
        f"(MSG,target {touch.target} is not touched: the program has no length of a probe)",
        f"O98 ELSEIF [{too_long} OR {too_short}]",
        f"(MSG,target {touch.target} is not touched: out of reach with this length of the probe)",
        "O98 ELSE",
        "(MSG,put the touch probe in place of the camera, then resume)",
        "M0",
        f"G53 G0 {across}",
        f"F{_APPROACH}",
        f"G53 G1 {name}{above}",
        f"(MSG,the ball {CLEARANCE_MM:g} mm above the dot of target {touch.target}? then resume)",
        "M0",
        f"#<omm_offset> = [#<_abs_{letter}> - #<_{letter}>]",
        f"G38.2 {name}[{below} - #<omm_offset>] F{_FAST}",
        f"#<omm_at> = [#{_probed(name)} + #<omm_offset>]",
        f"G53 G1 {name}[#<omm_at> {up} {_BACK_MM:g}]",
        f"G38.2 {name}[#<omm_at> {down} {_BACK_MM:g} - #<omm_offset>] F{_SLOW}",
        f"#<omm_at> = [#{_probed(name)} + #<omm_offset>]",
        f"#<omm_touched> = [{touch.z_mm:.4f} {up} [#<omm_at> - {touch.at:.4f}] - #<_omm_probe_mm>]",
        f"F{_APPROACH}",
        f"G53 G1 {name}{away:.4f}",
        "(LOGOPEN,omm_touched.txt)",
        f"(LOG,{told})",
        "(LOGCLOSE)",
        f"(DEBUG,{told})",
        "O98 ENDIF",
    ]


def _probed(name: str) -> int:
    """Return the number of the parameter that holds the probed place of an axis."""
    return 5061 + "XYZABCUVW".index(name)


def words_of_touch(touch: Touch, control: str) -> tuple[str, ...]:
    """Return the step in words, for the comments of another control's template."""
    across = " ".join(f"{n}{v:.4f}" for n, v in touch.beside.items())
    return (
        f"then touch target {touch.target}: retract, put the probe in place of the camera,",
        f"machine coordinates {across}, the dot's face near Z{touch.z_mm:.4f} of the plate's plan",
        f"by {OWN_CYCLE.get(control, 'the cycle for one face')}",
        "and write its height in machine coordinates into set.yaml as touched",
    )
