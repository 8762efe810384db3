"""Controls that speak OPC UA (OPC 40502, "OPC UA for CNC Systems", or names from a file).

The client runs in a thread of its own; what it hears is put together to samples there and waits in
a queue for ``read``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar

from omm_cnc_bridge.clock import ControlClock
from omm_cnc_bridge.control import ControlSample, WorkOffset
from omm_cnc_bridge.controls.opcua.logging_in import Security
from omm_cnc_bridge.controls.opcua.mapping import Mapping40502, load_mapping
from omm_cnc_bridge.controls.opcua.session import Session
from omm_core.errors import DeviceError, InputError

T = TypeVar("T")
CONNECT_TIMEOUT_S = 20.0
OFFSET_TIMEOUT_S = 5.0
SILENCE_S = 5.0


class OpcUaControl:
    """A server at ``url``. ``mapping_file`` may be empty, see `mapping`."""

    name = "opcua"

    def __init__(
        self, url: str, *, rate_hz: float, mapping_file: str = "", security: Security | None = None
    ) -> None:
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what it logs we tell ourselves
        self.clock = ControlClock()
        self._url, self._rate_hz = url, rate_hz
        self._mapping = load_mapping(Path(mapping_file)) if mapping_file else Mapping40502()
        self._security = security or Security()
        self._samples: queue.Queue[ControlSample | DeviceError] = queue.Queue()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._session: Session | None = None
        self._silent_s = 0.0
        self._namespaces: list[str] = []
        self._was_connected = False

    @property
    def revised_interval_s(self) -> float | None:
        """How often the server samples, which may be less often than it was asked for."""
        return self._session.revised_interval_s if self._session else None

    def connect(self) -> None:
        """Connect to the server and subscribe, in a thread of its own."""
        self.close()
        self.clock = ControlClock()
        self._samples = queue.Queue()
        self._silent_s = 0.0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="opcua", daemon=True)
        self._thread.start()
        session = Session(
            self._url,
            self._mapping,
            self._security,
            interval_s=1.0 / self._rate_hz,
            clock=self.clock,
            namespaces=self._namespaces,
            put=self._samples.put,
        )
        self._session = session
        try:
            self._await(session.open(), CONNECT_TIMEOUT_S)
            self._was_connected = True
        except InputError as error:
            if self._was_connected:  # a server that starts may not have all its nodes yet
                raise DeviceError(str(error)) from error
            raise
        except DeviceError:
            raise
        except Exception as error:  # asyncua raises of its own, of asyncio's and of ssl's
            text = str(error) or type(error).__name__
            raise DeviceError(f"OPC UA server {self._url}: {text}.") from error

    def read(self, timeout_s: float) -> Sequence[ControlSample]:
        """Return the samples that have come, oldest first; wait for the first of them."""
        try:
            first = self._samples.get(timeout=timeout_s)
        except queue.Empty:
            self._silent_s += timeout_s
            if self._silent_s > SILENCE_S:
                raise DeviceError(
                    f"OPC UA server {self._url}: silent for {SILENCE_S:g} s."
                ) from None
            return ()
        self._silent_s = 0.0
        items = [first]
        while not self._samples.empty():
            items.append(self._samples.get_nowait())
        for item in items:
            if isinstance(item, DeviceError):
                raise item
        return [item for item in items if isinstance(item, ControlSample)]

    def acknowledge(self, request: int) -> None:
        """Write the number of an image into the node of the acknowledgement."""
        session = self._session
        if session is None or not self._mapping.acknowledge:
            raise DeviceError("OPC UA: the mapping names no node to acknowledge images with.")
        try:
            self._await(session.acknowledge(request), 5.0)
        except Exception as error:
            raise DeviceError(f"OPC UA: image {request} is not acknowledged: {error}.") from error

    def work_offset(self, name: str) -> WorkOffset:
        """Return an offset that the mapping file names."""
        return self._offset(name, None, OFFSET_TIMEOUT_S)

    def set_work_offset(self, offset: WorkOffset, timeout_s: float) -> WorkOffset:
        """Write an offset that the mapping file names, and read it back."""
        return self._offset(offset.name, offset, timeout_s)

    def _offset(self, name: str, wanted: WorkOffset | None, timeout_s: float) -> WorkOffset:
        session, known = self._session, self._mapping.offsets
        if name not in known:
            raise DeviceError(
                f"OPC UA: the mapping file names no nodes of {name} under offsets, only"
                f" {', '.join(known) or 'none at all'}."
            )
        if session is None:
            raise DeviceError("OPC UA: not connected.")
        try:
            return self._await(session.work_offset(name, wanted), timeout_s)
        except DeviceError:
            raise
        except Exception as error:  # asyncua raises of its own, of asyncio's and of ssl's
            text = str(error) or type(error).__name__
            raise DeviceError(f"OPC UA: {name}: {text}.") from error

    def close(self) -> None:
        """Disconnect and end the thread."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        session, self._session = self._session, None
        if session is not None:
            with contextlib.suppress(Exception):  # what is gone cannot be closed
                asyncio.run_coroutine_threadsafe(session.close(), loop).result(3.0)
        loop.call_soon_threadsafe(loop.stop)
        if self._thread is not None:
            self._thread.join(3.0)
        loop.close()

    def _await(self, work: Coroutine[Any, Any, T], timeout_s: float) -> T:
        if self._loop is None:
            work.close()
            raise DeviceError("OPC UA: not connected.")
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(timeout_s)
