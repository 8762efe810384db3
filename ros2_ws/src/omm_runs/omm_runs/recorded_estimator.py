"""What the live estimator left in a recording: its settings, its last word, what it forgot."""

import json
from dataclasses import dataclass, fields
from typing import Any

from omm_core.errors import InputError
from omm_core.files.machine import Machine
from omm_core.session.measurement import MeasurementOptions
from omm_core.session.pairing import PairingOptions
from omm_recording.reading import Recording

ESTIMATE = "/omm/estimate"
EVENTS = "/parameter_events"
NODE = "/estimator"
_LARGEST = 1e9
"""No setting is larger (mm, rad, s, px)."""

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
    """Return the estimator's parameters at the recording's end; empty if it was not running."""
    table = recording.metadata().get(f"omm_parameters {NODE}", {})
    settings = {name: _parsed(name, value) for name, value in table.items()}
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
    """Return a parameter's value from its message; None where it is not set."""
    names = (None, *_SCALARS, *_ARRAYS)
    name = names[value.type] if value.type < len(names) else None
    found = getattr(value, f"{name}_value") if name else None
    as_list = getattr(found, "tolist", None)
    return as_list() if as_list else found


def _parsed(name: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _unusable(name, text) from error


def _unusable(name: str, value: object) -> InputError:
    return InputError(
        f"The recording says that the estimator's parameter {name[:80]!r} was {str(value)[:80]!r},"
        " which it cannot have been: the recording was changed or is damaged."
    )


def _checked(name: str, value: Any, default: Any) -> Any:
    """Return a recorded setting, which must be of the kind of its default, and finite."""
    kinds: tuple[type, ...] = (int, float) if isinstance(default, float) else (type(default),)
    if default is None:
        kinds = (int, float, str, type(None))
    good = isinstance(value, kinds) and isinstance(value, bool) == isinstance(default, bool)
    if not good or (isinstance(value, int | float) and not abs(value) < _LARGEST):
        raise _unusable(name, value)
    return value


def options_from(settings: Settings, machine: Machine | None = None) -> MeasurementOptions:
    """Pair, detect and solve as an estimator with these settings does; default where not set."""
    from omm_core.part_pose import SolveOptions
    from omm_core.targets import DetectionOptions

    pairing = PairingOptions()
    names = {"standstill_tolerance_mm": "tolerance_mm", "standstill_tolerance_rad": "tolerance_rad"}
    values: Settings = {f.name: getattr(pairing, f.name) for f in fields(pairing)}
    values |= {
        names[k]: _checked(k, v, float(values[names[k]])) for k, v in settings.items() if k in names
    }
    for name in ("window", "gap"):
        if f"standstill_{name}_s" in settings:
            told = _checked(name, settings[f"standstill_{name}_s"], 0.0)
            values[f"{name}_ns"] = round(told * 1e9)
    found_settings = _of_class(SolveOptions, settings)
    if settings.get("machine_sigma_mm"):  # 0, and recordings of before: estimated from the run
        sigma = _checked("machine_sigma_mm", settings["machine_sigma_mm"], 0.0)
        found_settings.setdefault("stop_sigma_mm", sigma)
    solve: SolveOptions = SolveOptions(**found_settings)
    if machine is not None:
        solve = solve.of_machine(machine.uncertainty)
    found = _of_class(DetectionOptions, settings)
    if "max_dot_diameter_px" in settings:
        told = _checked("max_dot_diameter_px", settings["max_dot_diameter_px"], 0.0)
        found["max_diameter_px"] = told
    detection: DetectionOptions = DetectionOptions(**found)
    return MeasurementOptions(pairing=PairingOptions(**values), solve=solve, detection=detection)


def left_out(settings: Settings) -> frozenset[int]:
    """Return the stamps (ns) of images that the live estimator was told to leave out."""
    stamps = settings.get("left_out_ns") or ()
    if not isinstance(stamps, list | tuple) or not all(type(stamp) is int for stamp in stamps):
        raise _unusable("left_out_ns", stamps)
    return frozenset(stamps)


def _of_class(kind: Any, settings: Settings) -> Settings:
    """Return those settings that a class of options has under the same name."""
    return {
        f.name: _checked(f.name, settings[f.name], f.default)
        for f in fields(kind)
        if f.name in settings
    }


def recorded_estimate(recording: Recording) -> RecordedEstimate | None:
    """Return the last estimate that the live node published."""
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
