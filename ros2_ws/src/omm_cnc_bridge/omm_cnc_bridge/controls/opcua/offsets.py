"""Work offsets behind OPC UA: exactly the nodes that the mapping file names, and none besides."""

from __future__ import annotations

import math
from collections.abc import Mapping

from asyncua import Node, ua

from omm_cnc_bridge.control import WorkOffset
from omm_cnc_bridge.controls.opcua.mapping import OFFSET_ITEMS, UNITS, OffsetNodes
from omm_core.errors import DeviceError
from omm_core.words import keyed, verbatim

LARGEST_TURN_RAD = 1e-9
LARGEST_MM = 100_000.0


def values_of(offset: WorkOffset, nodes: OffsetNodes) -> dict[str, float]:
    """Return what each node is to hold.

    Raises
    ------
    DeviceError
        Where a value is not a number, or a turn has no node.
    """
    numbers = (*offset.xyz_mm, *offset.euler_xyz_rad)
    if not all(math.isfinite(number) for number in numbers):
        raise DeviceError(f"Expected finite numbers for {offset.name}, got {numbers}.")
    if max(abs(number) for number in offset.xyz_mm) > LARGEST_MM:
        raise DeviceError(f"Expected {offset.name} within ±{LARGEST_MM:g} mm, got {numbers}.")
    values = {}
    for item, number in zip(OFFSET_ITEMS, numbers, strict=True):
        if item in nodes.paths:
            values[item] = number / _unit(item, nodes)
        elif abs(number) > LARGEST_TURN_RAD:
            raise DeviceError(
                keyed(
                    "said.no_node",
                    "{offset}: a turn of {angle} mm/m about {axis} has no node {item} in the"
                    " mapping file; nothing is written.",
                    offset=offset.name, angle=f"{1e3 * number:.6f}",
                    axis="xyz"["ABC".index(item)], item=item,
                )
            )  # fmt: skip
    return values


def offset_of(name: str, values: Mapping[str, float], nodes: OffsetNodes) -> WorkOffset:
    """Return the offset that the nodes hold."""
    x, y, z, a, b, c = (
        values[item] * _unit(item, nodes) if item in values else 0.0 for item in OFFSET_ITEMS
    )
    return WorkOffset(name=name, xyz_mm=(x, y, z), euler_xyz_rad=(a, b, c))


def _unit(item: str, nodes: OffsetNodes) -> float:
    return UNITS[nodes.unit if item in "XYZ" else nodes.angle_unit]


async def read(nodes: Mapping[str, Node]) -> dict[str, float]:
    """Return what each node holds.

    Raises
    ------
    DeviceError
        Where a node holds no number.
    """
    values = {}
    for item, node in nodes.items():
        value = await node.read_value()
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DeviceError(f"Expected a number at node {item} of the offset, got {value!r}.")
        values[item] = float(value)
    return values


async def write(nodes: Mapping[str, Node], values: Mapping[str, float]) -> None:
    """Write each node; where one refuses, what was written already is put back.

    Raises
    ------
    DeviceError
        Where a node refuses, naming it.
    """
    before = await read(nodes)
    written: list[str] = []
    for item, value in values.items():
        try:
            await _write(nodes[item], value)
            written.append(item)
        except ua.UaError as error:
            for done in written:
                await _write(nodes[done], before[done])
            raise DeviceError(
                keyed(
                    "said.node_not_written",
                    "Node {item} of the offset was not written ({why}); the others are as before.",
                    item=item,
                    why=verbatim(str(error)),
                )
            ) from error


async def _write(node: Node, value: float) -> None:
    kind = await node.read_data_type_as_variant_type()
    if kind not in (ua.VariantType.Double, ua.VariantType.Float):
        raise ua.UaError(f"it holds {kind.name}, expected Double or Float")
    await node.write_value(ua.DataValue(ua.Variant(value, kind)))
