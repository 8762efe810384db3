"""What the live estimator left in a recording: its settings, its last word, what it forgot."""

import json
from dataclasses import dataclass, fields
from typing import Any

from omm_core.files.machine import Machine
from omm_core.session.measurement import MeasurementOptions
from omm_core.session.pairing import PairingOptions
from omm_recording.reading import Recording

ESTIMATE = "/omm/estimate"
EVENTS = "/parameter_events"
NODE = "/estimator"

Settings = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class RecordedEstimate:
    """The live estimator's last word in the recording."""

    part: str
    model: str
    theta_si: tuple[float, ...]
    """(alpha, beta, gamma, x, y, z, gamma_s), rad and m; NaN where not determined."""
    forgotten: frozenset[int]
    """Stamps (ns) of images of earlier clampings, which it was told to forget."""


def recorded_settings(recording: Recording) -> Settings:
    """The estimator's parameters at the end of the recording; empty where it was not running."""
    table = recording.metadata().get(f"omm_parameters {NODE}", {})
    settings = {name: json.loads(value) for name, value in table.items()}
    if not settings or EVENTS not in recording.topics:
        return settings
    for message in recording.messages([EVENTS]):
        event = recording.decode(message)
        if event.node == NODE:
            for changed in [*event.new_parameters, *event.changed_parameters]:
                settings[changed.name] = _value(changed.value)
    return settings


# In the order of rcl_interfaces/msg/ParameterType.
_SCALARS = ("bool", "integer", "double", "string")
_ARRAYS = ("byte_array", "bool_array", "integer_array", "double_array", "string_array")


def _value(value: Any) -> Any:
    """A parameter's value from its message; None where it is not set."""
    return getattr(value, f"{(*_SCALARS, *_ARRAYS)[value.type - 1]}_value") if value.type else None


def options_from(settings: Settings, machine: Machine | None = None) -> MeasurementOptions:
    """Pair, detect and solve as an estimator with these settings does; default where not set."""
    from omm_core.part_pose import SolveOptions
    from omm_core.targets import DetectionOptions

    pairing = PairingOptions()
    names = {"standstill_tolerance_mm": "tolerance_mm", "standstill_tolerance_rad": "tolerance_rad"}
    values: Settings = {f.name: getattr(pairing, f.name) for f in fields(pairing)}
    values |= {names[k]: v for k, v in settings.items() if k in names}
    for name in ("window", "gap"):
        if f"standstill_{name}_s" in settings:
            values[f"{name}_ns"] = round(settings[f"standstill_{name}_s"] * 1e9)
    found_settings = _of_class(SolveOptions, settings)
    if settings.get("machine_sigma_mm"):  # 0, and recordings of before: estimated from the run
        found_settings.setdefault("stop_sigma_mm", settings["machine_sigma_mm"])
    solve: SolveOptions = SolveOptions(**found_settings)
    if machine is not None:
        solve = solve.of_machine(machine.uncertainty)
    found = _of_class(DetectionOptions, settings)
    if "max_dot_diameter_px" in settings:
        found["max_diameter_px"] = settings["max_dot_diameter_px"]
    detection: DetectionOptions = DetectionOptions(**found)
    return MeasurementOptions(pairing=PairingOptions(**values), solve=solve, detection=detection)


def _of_class(kind: Any, settings: Settings) -> Settings:
    """Those settings that a class of options has under the same name."""
    return {f.name: settings[f.name] for f in fields(kind) if f.name in settings}


def recorded_estimate(recording: Recording) -> RecordedEstimate | None:
    """The last estimate that the live node published."""
    if ESTIMATE not in recording.topics:
        return None
    last: Any = None
    known: set[int] = set()
    forgotten: set[int] = set()
    clamping = 0
    for message in recording.messages([ESTIMATE]):
        estimate = recording.decode(message)
        stamps = {i.stamp.sec * 1_000_000_000 + i.stamp.nanosec for i in estimate.images}
        # The number falls when the node is started again: what it then does not know of was
        # measured all the same. Recordings of before there was a number: -1.
        number = getattr(estimate, "clamping", -1)
        if number > clamping or number < 0:
            forgotten |= known - stamps
        clamping = number
        known, last = known | stamps, estimate
    if last is None:
        return None
    return RecordedEstimate(
        part=str(last.part),
        model=str(last.model),
        theta_si=tuple(float(value) for value in last.theta),
        forgotten=frozenset(forgotten - stamps),
    )
