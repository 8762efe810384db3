"""The page's server: a fixed set of addresses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import tornado.web

from omm_operator.screen.commands import LARGEST_BODY
from omm_operator.screen.desk import Asker, Desk
from omm_operator.web import handlers
from omm_operator.web.access import Hosts, Sessions
from omm_operator.web.live import Live, Pages


def application(
    content: handlers.Content,
    desk: Desk,
    hosts: Hosts,
    sessions: Sessions,
    *,
    tell_tokens: Callable[[Asker], None],
    language: str,
) -> tuple[tornado.web.Application, Pages]:
    """Return the application and the pages that look on."""
    pages = Pages(content)
    who: dict[str, Any] = {"hosts": hosts, "sessions": sessions}
    rules: list[Any] = [
        (r"/", handlers.Start, who),
        (r"/session", handlers.Session, who),
        (r"/login", handlers.LogIn, {**who, "tell_tokens": tell_tokens}),
        (r"/file/([a-z_]{1,30}\.[a-z]{2,4})", handlers.File, who),
        (r"/language/([a-z]{2})\.json", handlers.Language, who),
        (r"/command", handlers.CommandPost, {**who, "desk": desk}),
        (r"/picture\.jpg", handlers.Picture, {**who, "content": content}),
        (r"/handover/([a-z]{1,20})", handlers.HandoverFile, {**who, "content": content}),
        (r"/report\.pdf", handlers.ReportFile, {**who, "content": content}),
        (r"/live", Live, {**who, "pages": pages, "language": language}),
    ]
    made = tornado.web.Application(
        rules,
        xsrf_cookies=True,
        xsrf_cookie_kwargs={"samesite": "Strict", "path": "/"},
        default_handler_class=handlers.Missing,
        default_handler_args=who,
        websocket_ping_interval=10,
        websocket_max_message_size=LARGEST_BODY,
        log_function=lambda handler: None,
    )
    return made, pages
