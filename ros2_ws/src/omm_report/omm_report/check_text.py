"""What ``./omm calibrate --check`` prints: the verdict, and what would have been seen."""

from omm_core.camera_calibration.check import CalibrationCheck, ParameterCheck


def check_lines(check: CalibrationCheck) -> list[str]:
    """Return the lines that people read."""
    lines = [
        f"{check.name}: {check.images} images, {check.observations} dots",
        _verdict(check),
        f"test of any change: p = {check.p_value:.2g} (chi-square {check.chi2:.1f}, "
        f"{check.degrees_of_freedom} degrees of freedom)",
    ]
    if check.explained_by:
        lines.append("what may have changed, if it was one thing alone:")
        by_name = {p.name: p for p in check.parameters}
        lines += [f"  {_change(by_name[name])}" for name in check.explained_by]
    seen = [p for p in check.parameters if p.seen]
    if seen:
        lines.append("what would have been seen, in 19 of 20 such runs:")
        lines += [f"  {_power(p)}" for p in seen]
    unseen = [p for p in check.parameters if not p.seen]
    if unseen and check.machine is not None:
        lines.append("what this run does not show:")
        lines += [f"  {_unseen(p)}" for p in unseen]
    return lines + [f"finding: {words}" for words in check.findings]


def _verdict(check: CalibrationCheck) -> str:
    if not check.holds:
        return "the calibration does NOT hold on this run: calibrate again"
    if not any(p.seen for p in check.parameters):
        return "this run says nothing of the calibration: it would show no plausible change of it"
    return "the calibration holds, as far as this run shows it"


def _change(p: ParameterCheck) -> str:
    return f"{p.name}: changed by {_unit(p.name, p.change)} (sigma {_unit(p.name, p.sigma)})"


def _power(p: ParameterCheck) -> str:
    return (
        f"a change of {p.name} by {_unit(p.name, p.detectable)} "
        f"(it would misplace a target by {p.moves_part_mm:.3f} mm)"
    )


def _unseen(p: ParameterCheck) -> str:
    return (
        f"{p.name} (a change by {_unit(p.name, p.plausible)} would misplace a target by "
        f"{p.moves_part_mm:.3f} mm, unseen)"
    )


def _unit(name: str, value: float) -> str:
    """Return a value with the unit that its name ends in; angles in mrad."""
    if name.endswith("_rad"):
        return f"{1000 * value:.3g} mrad"
    for unit in ("mm", "px", "px2", "px4"):
        if name.endswith(f"_{unit}"):
            shown = {"px2": "/px²", "px4": "/px⁴"}.get(unit, unit)
            if name in ("p1_px", "p2_px"):
                shown = "/px"
            return f"{value:.3g} {shown}"
    return f"{value:.3g}"
