"""An MTConnect agent for the tests: documents, header fields and streams as the reference agent's.

Not an independent one: it was written from the standard and the reference agent's documents by
those who wrote the client.
"""

from __future__ import annotations

import datetime
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

PROBE = """<?xml version="1.0" encoding="UTF-8"?>
<MTConnectDevices xmlns="urn:mtconnect.org:MTConnectDevices:{version}">
<Header creationTime="2026-11-22T20:00:00Z" sender="test" instanceId="{instance}" bufferSize="{size}"/>
<Devices><Device id="d1" name="mill" uuid="mill-1">
 <DataItems><DataItem category="EVENT" id="avail" type="AVAILABILITY"/></DataItems>
 <Components>
  <Axes id="ax" name="Axes"><Components>
   <Linear id="x" name="X"><DataItems>
    <DataItem category="SAMPLE" id="xw" type="POSITION" subType="ACTUAL" coordinateSystem="WORK" units="MILLIMETER"/>
    <DataItem category="SAMPLE" id="xa" name="Xact" type="POSITION" subType="ACTUAL" coordinateSystem="MACHINE" units="MILLIMETER"/>
    <DataItem category="SAMPLE" id="xc" name="Xcom" type="POSITION" subType="COMMANDED" coordinateSystem="MACHINE" units="MILLIMETER"/>
   </DataItems></Linear>
   <Linear id="y" name="Y"><DataItems>
    <DataItem category="SAMPLE" id="ya" name="Yact" type="POSITION" subType="ACTUAL" units="MILLIMETER"/>
   </DataItems></Linear>
   <Rotary id="b" name="B"><DataItems>
    <DataItem category="SAMPLE" id="ba" name="Bact" type="ANGLE" subType="ACTUAL" coordinateSystem="MACHINE" units="DEGREE"/>
   </DataItems></Rotary>
  </Components></Axes>
  <Controller id="c"><DataItems>
    <DataItem category="EVENT" id="mode" type="CONTROLLER_MODE"/></DataItems>
   <Components><Path id="p"><DataItems>
    <DataItem category="EVENT" id="exec" type="EXECUTION"/>
    <DataItem category="EVENT" id="prog" type="PROGRAM"/>
    <DataItem category="EVENT" id="line" type="LINE"/></DataItems></Path></Components>
  </Controller>
 </Components>
</Device></Devices></MTConnectDevices>"""  # noqa: E501
BOUNDARY = "a8e12eced4fb871ac096a99bf9728425"
TAGS = {"xw": "Position", "xa": "Position", "xc": "Position", "ya": "Position", "ba": "Angle",
        "mode": "ControllerMode", "exec": "Execution", "prog": "Program", "line": "Line",
        "avail": "Availability"}  # fmt: skip

GOOD = {"avail": "AVAILABLE", "xa": 71.45, "xc": 71.45, "ya": -2, "ba": 90, "xw": 999,
        "mode": "AUTOMATIC", "exec": "ACTIVE", "prog": "measure.ngc", "line": 12}  # fmt: skip


class Agent:
    """Serves what ``tell`` is given, from a buffer of ``size`` observations."""

    def __init__(self, version: str = "1.7", size: int = 4096, port: int = 0, *,
                 strict: bool = False, refuse: bool = False, lengths: bool = True,
                 ) -> None:  # fmt: skip
        self.version, self.size = version, size
        self.strict, self.refuse, self.lengths = strict, refuse, lengths
        self.probe = PROBE
        self.instance = 1
        self.clock_s = 0.0
        self.hang = False
        self._lock = threading.Lock()
        self._buffer: list[tuple[int, str, str, str]] = []
        self._current: dict[str, tuple[int, str, str, str]] = {}
        self._next = 1
        self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self.tell(**dict.fromkeys(TAGS, "UNAVAILABLE"))

    def __enter__(self) -> Agent:
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.hang = True
        self._server.shutdown()
        self._server.server_close()

    def tell(self, **values: object) -> None:
        """Observe values by data item, all at the present moment."""
        now = datetime.datetime.now(datetime.timezone.utc)
        stamp = (now + datetime.timedelta(seconds=self.clock_s)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        with self._lock:
            for item, value in values.items():
                row = (self._next, item, stamp, str(value))
                self._buffer = [*self._buffer[-self.size + 1 :], row]
                self._current[item] = row
                self._next += 1

    def restart(self) -> None:
        with self._lock:
            self.instance += 1
            self._buffer, self._next = [], 1

    def document(self, rows: list[tuple[int, str, str, str]], next_sequence: int) -> bytes:
        first = self._buffer[0][0] if self._buffer else self._next
        observed = "".join(
            f'<{TAGS[item]} dataItemId="{item}" sequence="{n}" timestamp="{stamp}">'
            f"{text}</{TAGS[item]}>"
            for n, item, stamp, text in rows
        )
        return (
            f'<?xml version="1.0" encoding="UTF-8"?><MTConnectStreams '
            f'xmlns="urn:mtconnect.org:MTConnectStreams:{self.version}"><Header '
            f'creationTime="2026-11-22T20:00:00Z" sender="test" instanceId="{self.instance}" '
            f'bufferSize="{self.size}" nextSequence="{next_sequence}" firstSequence="{first}" '
            f'lastSequence="{self._next - 1}"/><Streams><DeviceStream name="mill" uuid="mill-1">'
            f'<ComponentStream component="Axes" componentId="ax"><Samples>{observed}</Samples>'
            f"</ComponentStream></DeviceStream></Streams></MTConnectStreams>"
        ).encode()

    def current(self) -> bytes:
        with self._lock:
            return self.document(list(self._current.values()), self._next)

    def since(self, start: int) -> tuple[bytes, int]:
        with self._lock:
            rows = [row for row in self._buffer if row[0] >= start]
            return self.document(rows, self._next), self._next

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        agent = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_: object) -> None:
                """Silent."""

            def do_GET(self) -> None:
                url = urlsplit(self.path)
                if url.path.endswith("/sample"):
                    self._stream(parse_qs(url.query))
                    return
                if url.path.endswith("/probe"):
                    body = agent.probe.format(
                        version=agent.version, instance=agent.instance, size=agent.size
                    ).encode()
                else:
                    body = agent.current()
                self.send_response(200)
                self.send_header("Content-Type", "text/xml")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def _stream(self, query: dict[str, list[str]]) -> None:
                if agent.refuse or (agent.strict and int(query["count"][0]) > agent.size):
                    body = (
                        '<MTConnectError><Header/><Errors><Error errorCode="OUT_OF_RANGE">'
                        f"'count' must be less than {agent.size + 1}</Error></Errors>"
                        "</MTConnectError>"
                    ).encode()
                    self.send_response(404)
                    self.send_header("Content-Type", "text/xml")
                    self.send_header("Content-Length", str(len(body)))
                    self.end_headers()
                    self.wfile.write(body)
                    return
                kind = "mixed" if agent.version >= "2" else "x-mixed-replace"
                self.send_response(200)
                self.send_header("Content-Type", f"multipart/{kind};boundary={BOUNDARY}")
                self.send_header("Transfer-Encoding", "chunked")
                self.end_headers()
                start = int(query["from"][0])
                interval_s = int(query["interval"][0]) / 1e3
                heartbeat_s = int(query["heartbeat"][0]) / 1e3
                quiet_since = time.monotonic()
                try:
                    while True:
                        time.sleep(interval_s)
                        if agent.hang:
                            continue
                        body, after = agent.since(start)
                        quiet = after == start and time.monotonic() - quiet_since < heartbeat_s
                        if quiet:
                            continue
                        start, quiet_since = after, time.monotonic()
                        length = b"Content-length: %d\r\n" % len(body) if agent.lengths else b""
                        self._chunk(
                            b"--%s\r\nContent-type: text/xml\r\n%s\r\n%s\r\n"
                            % (BOUNDARY.encode(), length, body)
                        )
                except OSError:
                    self.close_connection = True  # the client has gone

            def _chunk(self, data: bytes) -> None:
                # In two pieces, as a network would: a part may come in any number of them.
                for piece in (data[:100], data[100:]):
                    self.wfile.write(b"%x\r\n%s\r\n" % (len(piece), piece))
                    self.wfile.flush()

        return Handler
