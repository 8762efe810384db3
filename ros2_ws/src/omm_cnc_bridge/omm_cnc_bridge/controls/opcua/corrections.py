"""The correction of a program's next stop behind OPC UA: the five nodes that the mapping names.

The program reads them once it is answered (docs/cnc_controls.md). ``valid`` is taken back before
the numbers change and set after them: whoever reads between sees no correction, not half of one.
"""

from __future__ import annotations

from collections.abc import Mapping

from asyncua import Node, ua

from omm_cnc_bridge.controls.opcua.control import OpcUaControl
from omm_cnc_bridge.controls.opcua.mapping import UNITS, CorrectionNodes
from omm_core.errors import DeviceError

CORRECTION_TIMEOUT_S = 5.0
_FLOATS = (ua.VariantType.Double, ua.VariantType.Float)
_WHOLE = (
    ua.VariantType.SByte, ua.VariantType.Byte, ua.VariantType.Int16, ua.VariantType.UInt16,
    ua.VariantType.Int32, ua.VariantType.UInt32, ua.VariantType.Int64, ua.VariantType.UInt64,
)  # fmt: skip


class CorrectedOpcUaControl(OpcUaControl):
    """A control whose mapping names nodes for corrections."""

    def correct(self, shift_mm: tuple[float, float, float], status: int, *, valid: bool) -> None:
        """Set the correction that the program reads with the next answer; see TakesCorrections.

        Raises
        ------
        DeviceError
            Where the control is not connected, or a node does not take its number.
        """
        session, mapped = self._session, self._mapping.correction
        if session is None or mapped is None:
            raise DeviceError("OPC UA: not connected.")
        try:
            written = write(session.correction_nodes, mapped, shift_mm, status, valid=valid)
            self._await(written, CORRECTION_TIMEOUT_S)
        except DeviceError:
            raise
        except Exception as error:  # asyncua raises of its own, of asyncio's and of ssl's
            text = str(error) or type(error).__name__
            raise DeviceError(f"OPC UA: the correction is not written: {text}.") from error


async def write(
    nodes: Mapping[str, Node],
    mapped: CorrectionNodes,
    shift_mm: tuple[float, float, float],
    status: int,
    *,
    valid: bool,
) -> None:
    """Write a correction, ``valid`` last; where it is none, ``valid`` alone is taken back."""
    await _write("valid", nodes["valid"], 0)
    if not valid:
        return
    for axis, shift in zip("XYZ", shift_mm, strict=True):
        await _write(axis, nodes[axis], shift / UNITS[mapped.unit])
    await _write("status", nodes["status"], status)
    await _write("valid", nodes["valid"], 1)


async def _write(item: str, node: Node, value: float) -> None:
    """Write a number in the type that the node has; a length only where it can be a fraction."""
    kind = await node.read_data_type_as_variant_type()
    if kind in _FLOATS:
        told = ua.Variant(float(value), kind)
    elif item in ("status", "valid") and kind is ua.VariantType.Boolean:
        told = ua.Variant(bool(value), kind)
    elif item in ("status", "valid") and kind in _WHOLE:
        told = ua.Variant(int(value), kind)
    else:
        raise DeviceError(
            f"OPC UA: node {item} of the correction holds {kind.name}, expected"
            f" {'a number or Boolean' if item in ('status', 'valid') else 'Double or Float'}."
        )
    await node.write_value(ua.DataValue(told))
