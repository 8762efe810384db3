"""The state as it changes, to every page that looks on."""

from __future__ import annotations

import asyncio
import json
import math
from typing import Any

import tornado.web
import tornado.websocket

from omm_operator.screen.desk import Asker
from omm_operator.web.access import Hosts, Sessions
from omm_operator.web.handlers import COOKIE, Content, refuse_foreign, require_origin


def finite(value: Any) -> Any:
    """Return a state with None wherever there is no number."""
    if isinstance(value, dict):
        return {name: finite(held) for name, held in value.items()}
    if isinstance(value, list | tuple):
        return [finite(held) for held in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Pages:
    """The pages that look on: each gets the newest state, none holds up the others."""

    def __init__(self, content: Content) -> None:
        self._content = content
        self._live: set[Live] = set()

    def add(self, live: Live) -> None:
        """Take one more, and show it everything."""
        self._live.add(live)
        live.show(self._content.state())

    def remove(self, live: Live) -> None:
        """Forget one."""
        self._live.discard(live)

    def __len__(self) -> int:
        """Return how many look on."""
        return len(self._live)

    def show(self) -> None:
        """Show the newest state to all."""
        if self._live:
            state = self._content.state()
            for live in tuple(self._live):
                live.show(state)


class Live(tornado.websocket.WebSocketHandler):
    """The state as it changes. What is not sent yet when a newer one comes is dropped."""

    def initialize(self, hosts: Hosts, sessions: Sessions, pages: Pages, language: str) -> None:
        """Take what it needs."""
        self._hosts, self._sessions, self._pages = hosts, sessions, pages
        self._language = language
        self._asker: Asker | None = None
        self._sending: asyncio.Future[None] | None = None
        self._waiting: dict[str, Any] | None = None

    def prepare(self) -> None:
        """Refuse strangers before anything is opened."""
        refuse_foreign(self.request, self._hosts)
        require_origin(self.request, self._hosts)
        self._asker = self._sessions.find(self.get_cookie(COOKIE))
        if self._asker is None:
            raise tornado.web.HTTPError(401)

    def check_origin(self, origin: str) -> bool:
        """Return whether it is this page; `prepare` has looked, too."""
        return self._hosts.is_origin(origin, self.request.headers.get("Host"))

    def open(self, *args: str, **kwargs: str) -> None:
        """Show everything."""
        self.set_nodelay(True)
        self._pages.add(self)

    def on_message(self, message: str | bytes) -> None:
        """Take nothing: commands are posted."""
        self.close(1003, "commands are posted")

    def on_close(self) -> None:
        """Forget the page."""
        self._pages.remove(self)

    def show(self, state: dict[str, Any]) -> None:
        """Send a state, or keep it until the one before is out."""
        if self._sending is not None and not self._sending.done():
            self._waiting = state
            return
        assert self._asker is not None  # `prepare` has looked
        own = {"who": self._asker.who, "role": self._asker.role, "language": self._language}
        # A browser reads no NaN: one number would take the whole page away.
        words = json.dumps(finite({**state, "me": own}), allow_nan=False, ensure_ascii=False)
        try:
            self._sending = asyncio.ensure_future(self.write_message(words))
        except tornado.websocket.WebSocketClosedError:
            self._pages.remove(self)
            return
        self._sending.add_done_callback(self._sent)

    def _sent(self, sending: asyncio.Future[None]) -> None:
        if sending.cancelled() or sending.exception() is not None:
            self._pages.remove(self)
            return
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self.show(waiting)
