"""Parameters of a node, declared in one place: a frozen dataclass.

@dataclass(frozen=True, kw_only=True)
class Parameters:
    rate_hz: float = parameter(100.0, "Poses published per second.", minimum=1.0)

parameters = declare(node, Parameters)
"""

import dataclasses
import os
import typing
from collections.abc import Callable
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from omm_core.errors import InputError, did_you_mean

P = TypeVar("P")


def parameter(
    default: Any,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = True,
) -> Any:
    """Declare a field of a parameter class.

    Read-only ones can be given at the start only.
    """
    metadata = {
        "description": description,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "read_only": read_only,
    }
    return dataclasses.field(default=default, metadata=metadata)


def network_parameter() -> Any:
    """Return the field of a node's parameters that opens the network."""
    return parameter(
        False,
        "Whether other machines may hear this node and speak to it. Nothing is encrypted or "
        "authenticated without SROS 2 (SECURITY.md).",
    )


def declare(node: Node, kind: type[P]) -> P:
    """Declare every field of `kind` on the node and return the values that it got.

    Raises
    ------
    InputError
        A value is of the wrong type, out of range or none of the choices; or a parameter was given
        that the node does not have.
    """
    values = {}
    types = typing.get_type_hints(kind)
    _refuse_unknown(node, kind)
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        try:
            declared = node.declare_parameter(
                field.name,
                _given(node, field),
                _descriptor(field),
                ignore_override=_names_file(field),
            )
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise InputError(
                f"Parameter {field.name}: expected {_expected(field, types[field.name])}, {error}."
            ) from error
        values[field.name] = _checked(field, types[field.name], declared.value)
    return kind(**values)


# What rclpy and DDS themselves take as parameters of every node.
_OF_ROS = ("use_sim_time", "start_type_description_service", "autostart")
_OF_ROS_PREFIXES = ("qos_overrides.", "diagnostic_updater.")


def _refuse_unknown(node: Node, kind: type) -> None:
    """Refuse unknown parameters: a misspelt `exposre_us` would leave the exposure as it was."""
    # rclpy keeps what it was given here and offers no public way to it.
    given = node._parameter_overrides
    fields = {field.name for field in dataclasses.fields(kind)}
    known = sorted({*fields, *node._parameters, *_OF_ROS})
    for name in given:
        if name in known or name.startswith(_OF_ROS_PREFIXES):
            continue
        raise InputError(
            f"Parameter {name}: {node.get_name()} has none of that name."
            f"{did_you_mean(name, known)} All are listed by --help. "
            "(A parameter file's part `/**` reaches every node.)"
        )


def watch(node: Node, current: P, changed: Callable[[P], None]) -> None:
    """Call `changed` with the new parameters whenever some are set at run time.

    `changed` may raise InputError: then nothing is set, and its text is the answer.
    """
    kind = type(current)
    types = typing.get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    state = {"current": current}

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        try:
            news = {
                p.name: _checked(fields[p.name], types[p.name], p.value)
                for p in parameters
                if p.name in fields
            }
            if news:
                updated = dataclasses.replace(state["current"], **news)  # type: ignore[type-var]
                changed(updated)
                state["current"] = updated
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def _descriptor(field: "dataclasses.Field[Any]") -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=field.metadata["description"],
        read_only=field.metadata["read_only"],
        # An integer is welcome where a floating-point number is expected: `-p rate_hz:=100`; and
        # rclpy takes an empty list for one of bytes.
        dynamic_typing=isinstance(field.default, float) or field.default == (),
    )
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    if field.metadata["choices"]:
        descriptor.additional_constraints = "one of: " + ", ".join(field.metadata["choices"])
    if (low is not None or high is not None) and isinstance(field.default, int):
        limits = IntegerRange(
            from_value=int(low if low is not None else -(2**63)),
            to_value=int(high if high is not None else 2**63 - 1),
            step=1,
        )
        descriptor.integer_range = [limits]
    elif low is not None or high is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=float(low if low is not None else -1.7e308),
                to_value=float(high if high is not None else 1.7e308),
            )
        ]
    return descriptor


def _names_file(field: "dataclasses.Field[Any]") -> bool:
    return isinstance(field.default, str) and field.name.endswith("_file")


def _given(node: Node, field: "dataclasses.Field[Any]") -> Any:
    """Return the default; of a file, its absolute path, as nodes elsewhere read it, too."""
    if not _names_file(field):
        return _to_ros(field.default)
    override = node._parameter_overrides.get(field.name)
    value = field.default if override is None else override.value
    return os.path.abspath(value) if isinstance(value, str) and value else value


def _to_ros(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _checked(field: "dataclasses.Field[Any]", kind: Any, value: Any) -> Any:
    """Return the value in the field's type, checked where rclpy does not check it itself."""
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if typing.get_origin(kind) is tuple:
        of = typing.get_args(kind)[0]
        if isinstance(value, str | bytes) or not all(isinstance(v, of) for v in value or ()):
            raise InputError(
                f"Parameter {field.name}: expected a list of {of.__name__}, got {value!r}."
            )
        value = tuple(value if value is not None else ())
    elif not isinstance(value, kind):
        raise InputError(
            f"Parameter {field.name}: expected {_expected(field, kind)}, got {value!r}."
        )
    outside = isinstance(value, int | float) and (
        (low is not None and value < low) or (high is not None and value > high)
    )
    unknown = field.metadata["choices"] and value not in field.metadata["choices"]
    if outside or unknown:
        raise InputError(
            f"Parameter {field.name}: expected {_expected(field, kind)}, got {value!r}."
        )
    return value


def _expected(field: "dataclasses.Field[Any]", kind: Any) -> str:
    if field.metadata["choices"]:
        return "one of " + ", ".join(field.metadata["choices"])
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    name = getattr(kind, "__name__", str(kind))
    if low is None and high is None:
        return f"a value of type {name}"
    return f"{name} from {'-∞' if low is None else low} to {'∞' if high is None else high}"
