"""What a node prints when it is asked for `--help`: what it is for, and all its parameters."""

import dataclasses
import sys
import textwrap

_WIDTH = 96


def asked(arguments: list[str] | None) -> bool:
    """Tell whether the command line asks for help rather than for a node."""
    words = sys.argv[1:] if arguments is None else arguments
    return any(word in ("-h", "--help") for word in words)


def help_text(purpose: str, kind: type) -> str:
    """Describe the parameters of a node.

    Parameters
    ----------
    purpose : what the node is for; its first line is shown
    kind : the dataclass that holds the node's parameters
    """
    lines = [purpose.strip().splitlines()[0], "", "Parameters (-p NAME:=VALUE after --ros-args):"]
    for field in dataclasses.fields(kind):
        facts = [f"default {_shown(field.default)}"]
        facts += [_range(field)] if _range(field) else []
        facts += [] if field.metadata["read_only"] else ["may be set while the node runs"]
        words = f"{field.metadata['description']} [{', '.join(facts)}]"
        lines.append(f"  {field.name}")
        lines += textwrap.wrap(words, _WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)
    example = "--ros-args -p NAME:=VALUE --params-file FILE.yaml -r __node:=NAME -r __ns:=/MILL"
    return "\n".join([*lines, "", f"ROS arguments: {example}", ""])


def _shown(value: object) -> str:
    if value in ("", ()):
        return "empty"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _range(field: "dataclasses.Field[object]") -> str:
    if field.metadata["choices"]:
        return "one of " + ", ".join(field.metadata["choices"])
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    if low is None and high is None:
        return ""
    if high is None:
        return f"at least {low:g}"
    return f"at most {high:g}" if low is None else f"{low:g} to {high:g}"
