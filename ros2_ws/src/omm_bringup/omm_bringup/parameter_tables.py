"""All parameters of all nodes as tables: docs/parameters.md is what this prints.

./omm exec python -m omm_bringup.parameter_tables > docs/parameters.md
"""

import dataclasses
import importlib
import math

NODES = {
    "camera": "omm_camera_driver.parameters.Parameters",
    "cnc_bridge": "omm_cnc_bridge.parameters.Parameters",
    "estimator": "omm_estimator.parameters.Parameters",
    "stored_result": "omm_estimator.stored_result_node.Parameters",
    "operator": "omm_operator.parameters.Parameters",
    "overlay": "omm_operator.overlay_node.Parameters",
    "scene": "omm_operator.scene_node.Parameters",
    "recorder": "omm_recorder.parameters.Parameters",
    "replay": "omm_recorder.replay.ReplayParameters",
}
_HEAD = """# Parameters

Those of each node, from its code (`python -m omm_bringup.parameter_tables`). "Live" ones can be
changed while the node runs (`ros2 param set`); the others are read-only. What is out of range is
refused with the range.
"""


def tables() -> str:
    """Return all tables as Markdown."""
    return "\n".join([_HEAD, *(_table(node, parameters_of(node)) for node in NODES)])


def parameters_of(node: str) -> type:
    """Return the dataclass of a node's parameters."""
    module, name = NODES[node].rsplit(".", 1)
    return getattr(importlib.import_module(module), name)


def _table(node: str, kind: type) -> str:
    lines = [f"## {node}", "", "| parameter | default | may be | live | what it is |"]
    lines.append("|---|---|---|---|---|")
    for field in dataclasses.fields(kind):
        live = "" if field.metadata["read_only"] else "yes"
        description = field.metadata["description"].replace("|", r"\|")
        words = (f"`{field.name}`", _value(field.default), _range(field), live, description)
        lines.append(f"| {' | '.join(words)} |")
    return "\n".join([*lines, ""])


def _value(value: object) -> str:
    empty = value in ("", (), ("",)) or (isinstance(value, float) and math.isnan(value))
    return "" if empty else f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _range(field: "dataclasses.Field[object]") -> str:
    if field.metadata["choices"]:
        return ", ".join(f"`{choice}`" for choice in field.metadata["choices"])
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    if low is None and high is None:
        return ""
    if high is None:
        return f"≥ {low:g}"
    return f"≤ {high:g}" if low is None else f"{low:g} to {high:g}"


if __name__ == "__main__":
    print(tables(), end="")
