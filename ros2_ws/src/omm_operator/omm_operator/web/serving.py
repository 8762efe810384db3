"""The server in a thread of its own, with an event loop of its own, beside a node that spins."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tornado.httpserver

from omm_core.errors import InputError
from omm_operator.screen.commands import LARGEST_BODY
from omm_ros.leaving import leave

END_S = 3.0
# Whoever opens connections and never finishes a request must not keep others out for long.
IDLE_S = 60.0


def listen(address: str, port: int) -> tuple[list[socket.socket], int]:
    """Return bound sockets, and the port that they have.

    Raises
    ------
    InputError
        Where the address is not ours or the port is taken.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        listening = socket.create_server((address, port), family=family, backlog=128)
    except OSError as error:
        raise InputError(
            f"Expected to listen at {address}, port {port}: {error.strerror or error}. Another"
            " page may run there: end it, or choose another port."
        ) from error
    listening.setblocking(False)
    return [listening], int(listening.getsockname()[1])


def tls_context(certificate_file: str, key_file: str) -> ssl.SSLContext | None:
    """Return what makes https of it; None where no certificate was given.

    Raises
    ------
    InputError
        Where one of the two is missing or cannot be used.
    """
    if not certificate_file and not key_file:
        return None
    if not certificate_file or not key_file:
        raise InputError("Expected both tls_certificate_file and tls_key_file, got one of them.")
    for path in (certificate_file, key_file):
        if not Path(path).is_file():
            raise InputError(f"Expected a PEM file at {path}, found none.")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate_file, key_file)
    except (ssl.SSLError, OSError) as error:
        raise InputError(
            f"Expected a certificate with its key in {certificate_file}, {key_file}: {error}."
        ) from error
    return context


class ServerThread:
    """Runs a server until it is closed.

    Parameters
    ----------
    sockets : list of socket
    context : SSLContext or None
    make : callable
        Makes the application; called in the thread, where its event loop runs.
    """

    def __init__(
        self, sockets: list[socket.socket], context: ssl.SSLContext | None, make: Callable[[], Any]
    ) -> None:
        # What strangers send is refused, which is no news; tornado would log each.
        logging.getLogger("tornado.access").setLevel(logging.CRITICAL)
        logging.getLogger("tornado.general").setLevel(logging.ERROR)
        self._sockets, self._context, self._make = sockets, context, make
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self.failure: Exception | None = None
        """What ended the thread before it was closed."""

    def start(self) -> None:
        """Start; returns when the server takes requests."""
        self._thread.start()
        self._ready.wait()

    def call(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the server's thread; do nothing once that has ended."""
        if not self._loop.is_closed():
            try:
                self._loop.call_soon_threadsafe(function, *arguments)
            except RuntimeError:
                if not self._loop.is_closed():
                    raise

    def close(self) -> None:
        """End the server and its thread."""
        self.call(self._ended.set)
        self._thread.join(END_S)
        if self._thread.is_alive():
            leave(self._thread)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as error:
            self.failure = error
        finally:
            self._loop.close()
            self._ready.set()

    async def _serve(self) -> None:
        server = tornado.httpserver.HTTPServer(
            self._make(),
            ssl_options=self._context,
            max_body_size=4 * LARGEST_BODY,
            max_header_size=16_384,
            idle_connection_timeout=IDLE_S,
            body_timeout=10.0,
            xheaders=False,
        )
        server.add_sockets(self._sockets)
        self._ready.set()
        await self._ended.wait()
        server.stop()
        await server.close_all_connections()
