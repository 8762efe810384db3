"""One connection to an OPC UA server: logs in, finds the nodes, subscribes, writes."""

from __future__ import annotations

from collections.abc import Callable

from asyncua import Client, Node, ua
from asyncua.common.subscription import Subscription

from omm_cnc_bridge.clock import ControlClock
from omm_cnc_bridge.control import ControlSample, WorkOffset
from omm_cnc_bridge.controls.opcua import offsets
from omm_cnc_bridge.controls.opcua.addresses import Addresses
from omm_cnc_bridge.controls.opcua.logging_in import Security, log_in
from omm_cnc_bridge.controls.opcua.mapping import Mapping40502
from omm_cnc_bridge.controls.opcua.nodes import CLOCK, POSITIONS, Key, NodeFinder
from omm_cnc_bridge.controls.opcua.samples import SampleMaker
from omm_core.errors import DeviceError

QUEUE = 20


class Session:
    """See the module; all methods run in the client's event loop."""

    def __init__(
        self,
        url: str,
        mapping: Mapping40502,
        security: Security,
        *,
        interval_s: float,
        clock: ControlClock,
        namespaces: list[str],
        put: Callable[[ControlSample | DeviceError], None],
    ) -> None:
        self._namespaces = namespaces
        self._url, self._security, self._mapping = url, security, mapping
        self._client = Client(url, timeout=4.0, watchdog_intervall=2.0)
        self._interval_s = interval_s
        self._clock, self._put = clock, put
        self._samples: SampleMaker | None = None
        self._acknowledge: Node | None = None
        self._offsets: dict[str, dict[str, Node]] = {}
        self.correction_nodes: dict[str, Node] = {}

    @property
    def revised_interval_s(self) -> float:
        """The interval that the server really keeps, as far as known."""
        return self._interval_s if self._samples is None else self._samples.revised_interval_s

    async def open(self) -> None:
        """Connect, find the nodes, subscribe."""
        notes = await log_in(self._client, self._url, self._security)
        await self._client.load_data_type_definitions()
        self._client.connection_lost_callback = self._on_lost
        addresses = Addresses(self._client, self._namespaces)
        finder = NodeFinder(self._client, self._mapping, addresses)
        nodes = await finder.nodes()
        self._samples = SampleMaker(
            finder,
            self._mapping,
            {node.nodeid: key for key, node in nodes.items()},
            notes=notes,
            interval_s=self._interval_s,
            clock=self._clock,
            put=self._put,
        )
        if self._mapping.acknowledge:
            self._acknowledge = await addresses.variable(self._mapping.acknowledge, "acknowledge")
        for name, offset in self._mapping.offsets.items():
            self._offsets[name] = {
                i: await addresses.variable(p, f"{i} of the offset {name}")
                for i, p in offset.paths.items()
            }
        if (correction := self._mapping.correction) is not None:
            self.correction_nodes = {
                i: await addresses.variable(p, f"{i} of the correction")
                for i, p in correction.paths.items()
            }
        await self._subscribe(nodes)

    async def close(self) -> None:
        """Disconnect, without reporting that as a loss."""
        self._client.connection_lost_callback = None
        await self._client.disconnect()

    async def acknowledge(self, request: int) -> None:
        """Write the number of an image, in the type that the node has."""
        assert self._acknowledge is not None
        variant = await self._acknowledge.read_data_type_as_variant_type()
        await self._acknowledge.write_value(ua.DataValue(ua.Variant(request, variant)))

    async def work_offset(self, name: str, wanted: WorkOffset | None) -> WorkOffset:
        """Return a work offset, after writing it where one is given."""
        nodes, mapped = self._offsets[name], self._mapping.offsets[name]
        if wanted is not None:
            await offsets.write(nodes, offsets.values_of(wanted, mapped))
        return offsets.offset_of(name, await offsets.read(nodes), mapped)

    # --- connecting ----------------------------------------------------------------------------

    async def _on_lost(self, error: Exception) -> None:
        self._put(DeviceError(f"OPC UA: the connection is lost ({error!r})."))

    async def _subscribe(self, nodes: dict[Key, Node]) -> None:
        interval_ms = self._interval_s * 1e3
        subscription = await self._client.create_subscription(interval_ms, self._samples)
        stamps_too = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
        asked_ms = await self._interval_to_ask_for(subscription, nodes)
        for handle, (key, node) in enumerate(nodes.items(), start=1):
            request = _request(
                node, handle, asked_ms, queue=QUEUE, only=None if key == CLOCK else stamps_too
            )
            (made,) = await subscription.create_monitored_items([request])
            if isinstance(made, ua.StatusCode):
                what = f"{key[1]} of axis {key[0]}" if key[0] else key[1]
                raise DeviceError(
                    f"OPC UA: the server does not report {what}"
                    f" ({node.nodeid.to_string()}): {made.name}."
                )

    async def _interval_to_ask_for(
        self, subscription: Subscription, nodes: dict[Key, Node]
    ) -> float:
        """Return our interval (ms); 0 where the server revises ours upwards but 0 less.

        Such a server samples by slow timers, or reports every change (OPC 10000-4, 5.12.1.2).
        Others could flood us when asked for 0.
        """
        interval_ms = self._interval_s * 1e3
        trial = next(node for (_, item), node in nodes.items() if item in POSITIONS)
        disabled = ua.MonitoringMode.Disabled
        # Not by the subscription, which does not tell what interval the server will keep.
        made = await subscription.server.create_monitored_items(
            ua.CreateMonitoredItemsParameters(
                SubscriptionId=subscription.subscription_id,
                ItemsToCreate=[
                    _request(trial, handle, asked_ms, mode=disabled)
                    for handle, asked_ms in enumerate((interval_ms, 0.0), start=1)
                ],
            )
        )
        await subscription.server.delete_monitored_items(
            ua.DeleteMonitoredItemsParameters(
                SubscriptionId=subscription.subscription_id,
                MonitoredItemIds=[item.MonitoredItemId for item in made],
            )
        )
        revised_ms = [item.RevisedSamplingInterval for item in made]
        ours_ms, fastest_ms = revised_ms
        return 0.0 if ours_ms > 1.5 * interval_ms and fastest_ms < ours_ms else interval_ms


def _request(
    node: Node,
    handle: int,
    sampling_ms: float,
    *,
    queue: int = 1,
    only: ua.DataChangeFilter | None = None,
    mode: ua.MonitoringMode = ua.MonitoringMode.Reporting,
) -> ua.MonitoredItemCreateRequest:
    """Return the request to watch a node's value; the handle is the subscription's key for it."""
    asked = ua.MonitoringParameters(
        ClientHandle=handle, SamplingInterval=sampling_ms, QueueSize=queue, DiscardOldest=True
    )
    if only is not None:
        asked.Filter = only
    return ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node.nodeid, AttributeId=ua.AttributeIds.Value),
        MonitoringMode=mode,
        RequestedParameters=asked,
    )
