"""Documents out of an agent's answers: whole ones, and the parts of one that never ends."""

from __future__ import annotations

import http.client
import queue
import re
import threading
import time

from omm_cnc_bridge.controls.mtconnect.model import (
    read_document,
)
from omm_core.errors import DeviceError

SILENCE_S = 5.0
ANSWER_S = 20.0
LARGEST_ANSWER = 32 << 20
_TOO_LARGE = "MTConnect: a part of the stream is larger than any real one."
_NO_LENGTH = "MTConnect: expected the length of a part as a number, its head has none."
_LAST_TAG = re.compile(rb"</(?:[\w.-]+:)?MTConnect\w+\s*>")


class MultipartReader:
    """Parts of a ``multipart/x-mixed-replace`` (to 1.x) or ``multipart/mixed`` (2.x) answer.

    A thread reads them: an HTTP answer in chunks cannot be read on after a time-out.
    """

    def __init__(self, response: http.client.HTTPResponse) -> None:
        kind = response.headers.get_content_type()
        boundary = response.headers.get_param("boundary")
        if not kind.startswith("multipart/") or not isinstance(boundary, str):
            with response:
                raise DeviceError(_refusal(kind, response.read(1 << 16)))
        self._response = response
        self._boundary = b"--" + boundary.removeprefix("--").encode()
        self._data = b""
        self._parts: queue.Queue[tuple[int, bytes] | DeviceError] = queue.Queue()
        threading.Thread(target=self._run, name="mtconnect", daemon=True).start()

    def read(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """Return when (monotonic clock, ns) and what came; wait for the first part."""
        parts: list[tuple[int, bytes]] = []
        try:
            item = self._parts.get(timeout=timeout_s)
            while True:
                if isinstance(item, DeviceError):
                    if parts:
                        self._parts.put(item)
                        return parts
                    raise item
                parts.append(item)
                item = self._parts.get_nowait()
        except queue.Empty:
            return parts

    def _run(self) -> None:
        """Read until the stream ends or the connection is closed under it."""
        try:
            while data := self._response.read1(1 << 16):
                received_ns = time.monotonic_ns()
                self._data += data
                if len(self._data) > 2 * LARGEST_ANSWER:
                    raise DeviceError("MTConnect: the stream has no parts. Is that an agent?")
                for part in self._whole_parts():
                    self._parts.put((received_ns, part))
            self._parts.put(DeviceError("MTConnect: the agent ended the stream."))
        except DeviceError as error:
            self._parts.put(error)
        except TimeoutError:
            self._parts.put(DeviceError(f"MTConnect: the agent is silent for {SILENCE_S:g} s."))
        except Exception as error:  # whatever it is, who reads must hear of it
            self._parts.put(DeviceError(f"MTConnect: the stream broke ({error})."))
        finally:
            self._response.close()

    def _whole_parts(self) -> list[bytes]:
        parts = []
        while (start := self._data.find(self._boundary)) >= 0:
            head_end = self._data.find(b"\r\n\r\n", start)
            if head_end < 0:
                break
            length = _content_length(self._data[start:head_end])
            end = self._end(head_end + 4) if length is None else head_end + 4 + length
            if end is None or len(self._data) < end:
                break
            parts.append(self._data[head_end + 4 : end])
            self._data = self._data[end:]
        return parts

    def _end(self, start: int) -> int | None:
        """Return where a part ends that does not tell its length; None where more must come.

        With its document, else with the next boundary, which comes a heartbeat later only.
        """
        tag = _LAST_TAG.search(self._data, start)
        boundary = self._data.find(b"\r\n" + self._boundary, start)
        ends = [end for end in (tag.end() if tag else -1, boundary) if end >= 0]
        if not ends and len(self._data) - start > LARGEST_ANSWER:
            raise DeviceError(_TOO_LARGE)
        return min(ends, default=None)


def _refusal(kind: str, body: bytes) -> str:
    """Return why there is no stream: in the agent's own words where it has some."""
    try:
        read_document(body)
    except DeviceError as error:
        if "the agent says" in str(error):
            return str(error)
    return f"MTConnect: expected a multipart stream, got {kind}."


def whole_answer(response: http.client.HTTPResponse) -> bytes:
    """Return a whole answer, limited in bytes and in time, even where it comes drop by drop."""
    data = bytearray()
    until_s = time.monotonic() + ANSWER_S
    while piece := response.read1(1 << 16):
        data += piece
        if len(data) > LARGEST_ANSWER or time.monotonic() > until_s:
            raise DeviceError(
                f"MTConnect: the agent's answer has no end ({len(data)} bytes in {ANSWER_S:g} s at"
                " most). Is that an agent?"
            )
    return bytes(data)


def _content_length(head: bytes) -> int | None:
    """Return the length that a part tells; None where it tells none."""
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            length = value.strip()
            if length.isdigit() and len(length) < 10 and int(length) <= LARGEST_ANSWER:
                return int(length)
            raise DeviceError(_TOO_LARGE if length.isdigit() else _NO_LENGTH)
    return None
