"""A control that speaks OPC UA, built on asyncua's server; moves X, Y and B as a test wants.

The tree has the browse names of OPC 40502; positions have ActPos and CmdPos below them.
"""

from __future__ import annotations

import asyncio
import datetime
import threading
from pathlib import Path

from asyncua import Server, ua
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.user_managers import UserManager

URI = "http://opcfoundation.org/UA/CNC"
AXES = {"X": ("MMT", "mm"), "Y": ("MMT", "mm"), "B": ("DD", "°")}


class OneUser(UserManager):
    def __init__(self) -> None:
        self.asked: list[tuple[str | None, str | None]] = []

    def get_user(self, iserver, username=None, password=None, certificate=None):
        self.asked.append((username, password))
        good = (username, password) == ("omm", "secret")
        return User(role=UserRole.Admin) if good else None


class OpcUaTestServer:
    """Runs in a thread; ``positions`` and ``commanded`` are what it says, at ``period_s``."""

    def __init__(self, port: int, *, period_s: float = 0.01, clock_s: float = 0.0, login=False,
                 certificate: Path | None = None, key: Path | None = None,
                 plain_too: bool = False) -> None:  # fmt: skip
        self.url = f"opc.tcp://127.0.0.1:{port}/cnc"
        self.positions = dict.fromkeys(AXES, 0.0)
        self.commanded = dict.fromkeys(AXES, 0.0)
        self.indirect: dict[str, float] | None = None
        """What PosIndirect says; set before the start where there is one."""
        self.direct_quality = None
        """Of PosDirect alone; None takes ``quality``."""
        self.more: dict[str, dict[str, object]] = {}
        """Further axes: the values of their variables, without a unit; None is BadNoData."""
        self.corrected: dict[str, object] = {}
        """What a bridge has written of the next stop's correction; set before the start."""
        self.corrections: list[dict[str, object]] = []
        self.status = 0
        self.quality = ua.StatusCodes.Good
        self.request = 0
        self.acknowledged = 0
        self.clock_s = clock_s
        self.hang = False
        self._period_s, self._login = period_s, login
        self._certificate, self._key = certificate, key
        self._plain_too = plain_too
        self.users = OneUser()
        self._stop = threading.Event()
        self.referenced: object = True
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)

    def __enter__(self) -> OpcUaTestServer:
        self._thread.start()
        assert self._ready.wait(30.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(10.0)

    async def _run(self) -> None:
        server = Server(user_manager=self.users if self._login else None)
        await server.init()
        server.set_endpoint(self.url)
        if self._certificate is not None:
            server.set_security_policy(
                [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
                + [ua.SecurityPolicyType.NoSecurity] * self._plain_too,
                permission_ruleset=SimpleRoleRuleset(),
            )
            await server.load_certificate(str(self._certificate))
            await server.load_private_key(str(self._key))
        else:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await self._build(server)
        async with server:
            self._ready.set()
            while not self._stop.is_set():
                await self._write()
                await asyncio.sleep(self._period_s)

    async def _build(self, server: Server) -> None:
        ns = await server.register_namespace(URI)
        interface = await server.nodes.objects.add_object(ns, "CncInterface")
        axes = await interface.add_object(ns, "CncAxisList")
        self._nodes = {}
        for name, (code, word) in AXES.items():
            axis = await axes.add_object(ns, name)
            position = await axis.add_variable(ns, "PosDirect", 0.0)
            units = ua.EUInformation()
            units.UnitId = int.from_bytes(code.encode(), "big")
            units.DisplayName = ua.LocalizedText(word)
            for item in ("ActPos", "CmdPos"):
                node = await position.add_variable(ns, item, 0.0)
                await node.add_property(0, "EngineeringUnits", units)
                self._nodes[name, item] = node
            if self.indirect is not None:
                indirect = await axis.add_variable(ns, "PosIndirect", 0.0)
                await indirect.add_property(0, "EngineeringUnits", units)
                self._nodes[name, "PosIndirect"] = indirect
            self._nodes[name, "ActStatus"] = await axis.add_variable(ns, "ActStatus", 0)
            await axis.add_variable(ns, "IsReferenced", self.referenced)
        for name, variables in self.more.items():
            axis = await axes.add_object(ns, name)
            for variable, value in variables.items():
                node = await axis.add_variable(ns, variable, 0.0 if value is None else value)
                if value is None:
                    bad = ua.StatusCode(ua.StatusCodes.BadNoData)
                    await node.write_value(ua.DataValue(ua.Variant(None), StatusCode=bad))
        spindles = await interface.add_object(ns, "CncSpindleList")
        angle = await (await spindles.add_object(ns, "S1")).add_variable(ns, "AnglePos", 0.0)
        await angle.add_variable(ns, "ActPos", 45.0)
        channels = await interface.add_object(ns, "CncChannelList")
        channel = await channels.add_object(ns, "1")
        await channel.add_variable(ns, "ActProgramStatus", 1)
        await channel.add_variable(ns, "ActOperationMode", 2)
        await channel.add_variable(ns, "ActMainProgramName", "measure.mpf")
        vendor = await server.nodes.objects.add_object(ns, "Vendor")
        self._nodes["", "request"] = await vendor.add_variable(ns, "ImageWanted", 0)
        answer = await vendor.add_variable(ns, "ImageTaken", 0)
        await answer.set_writable()
        self._nodes["", "answer"] = answer
        for name, value in self.corrected.items():
            node = await vendor.add_variable(ns, f"Stop{name}", value)
            await node.set_writable()
            self._nodes["", name] = node

    async def _write(self) -> None:
        if self.hang:
            return
        now = datetime.datetime.now(datetime.timezone.utc)
        stamp = now + datetime.timedelta(seconds=self.clock_s)
        for name in AXES:
            for item, values in (("ActPos", self.positions), ("CmdPos", self.commanded)):
                await self._nodes[name, item].write_value(
                    ua.DataValue(
                        ua.Variant(values[name], ua.VariantType.Double),
                        StatusCode=ua.StatusCode(self.direct_quality or self.quality),
                        SourceTimestamp=stamp,
                    )
                )
            if self.indirect is not None:
                value = ua.Variant(self.indirect[name], ua.VariantType.Double)
                await self._nodes[name, "PosIndirect"].write_value(
                    ua.DataValue(value, SourceTimestamp=stamp)
                )
            await self._nodes[name, "ActStatus"].write_value(
                ua.Variant(self.status, ua.VariantType.Int64)
            )
        await self._nodes["", "request"].write_value(ua.Variant(self.request, ua.VariantType.Int64))
        self.acknowledged = await self._nodes["", "answer"].read_value()
        seen = {name: await self._nodes["", name].read_value() for name in self.corrected}
        if seen != self.corrected:
            self.corrections.append(seen)
        self.corrected = seen
