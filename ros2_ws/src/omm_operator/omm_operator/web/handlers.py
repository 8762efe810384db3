"""The page's addresses, each of which checks who asks.

Every request: Host must be one of ours. Beyond the log-in: a session's cookie. What changes
something: Origin must be this page itself, and the XSRF token must be in a header.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

import tornado.web
from tornado.httputil import HTTPServerRequest

from omm_core.errors import InputError
from omm_core.words import of_error
from omm_operator.screen.commands import parse
from omm_operator.screen.desk import Asker, Desk
from omm_operator.web.access import Hosts, Sessions, is_loopback
from omm_report.language import LANGUAGES, catalogue, said_of

PAGE = Path(__file__).parents[1] / "page"
TYPES = {
    ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"
}  # fmt: skip
# Only these files are ever sent; what a request names is looked up here, never opened.
FILES = {path.name: path for path in PAGE.iterdir() if path.suffix in TYPES}
COOKIE = "omm_session"
POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none';"
    " object-src 'none'; img-src 'self' data:"
)


class Content(Protocol):
    """What the server shows besides its own files."""

    def state(self) -> dict[str, Any]:
        """Return the whole state."""

    def picture(self) -> bytes | None:
        """Return the newest picture as JPEG."""

    def handover_file(self, control: str) -> tuple[str, str] | None:
        """Return name and text of a file for a control; None where there is no pose to say."""

    def report_file(self) -> bytes | None:
        """Return the newest report as PDF."""


class Guarded(tornado.web.RequestHandler):
    """A request that is answered only where Host is ours."""

    hosts: Hosts
    sessions: Sessions
    session: Asker | None = None
    open_to_all = False

    def initialize(self, hosts: Hosts, sessions: Sessions, **more: Any) -> None:
        """Take what all handlers share."""
        self.hosts, self.sessions = hosts, sessions
        for name, value in more.items():
            setattr(self, name, value)

    def set_default_headers(self) -> None:
        """Send what keeps browsers from doing more than the page needs."""
        self.set_header("Content-Security-Policy", POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Cross-Origin-Opener-Policy", "same-origin")
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse strangers."""
        refuse_foreign(self.request, self.hosts)
        self.session = self.sessions.find(self.get_cookie(COOKIE))
        if self.session is None and not self.open_to_all:
            raise tornado.web.HTTPError(401)

    def write_error(self, status_code: int, **more: Any) -> None:
        """Write the status, and nothing about the server's inside."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")

    def begin_session(self, secret: str) -> None:
        """Give the browser its session and the token for its requests."""
        secure = self.request.protocol == "https"
        self.set_cookie(COOKIE, secret, httponly=True, samesite="Strict", secure=secure, path="/")
        self.xsrf_token  # noqa: B018  sets its cookie

    def is_from_here(self) -> bool:
        """Return whether the request came from this computer."""
        return is_loopback(self.request.remote_ip)


def refuse_foreign(request: HTTPServerRequest, hosts: Hosts) -> None:
    """Raise HTTPError where Host is not ours, or an Origin is given that is not this page."""
    host, origin = request.headers.get("Host"), request.headers.get("Origin")
    if len(request.headers.get_list("Host")) != 1 or not hosts.knows(host):
        raise tornado.web.HTTPError(421)
    if origin is not None and not hosts.is_origin(origin, host):
        raise tornado.web.HTTPError(403)
    # Browsers say who asks. From elsewhere, the page may be gone to, but not be looked into.
    foreign = request.headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
    goes_there = request.path == "/" and request.headers.get("Sec-Fetch-Mode") == "navigate"
    if foreign and not goes_there:
        raise tornado.web.HTTPError(403)


class Start(Guarded):
    """The page itself; the log-in where there is no session yet."""

    open_to_all = True

    def get(self) -> None:
        """Send it."""
        if self.session is None and self.is_from_here():
            self.begin_session(self.sessions.open("operator", self.request.remote_ip or ""))
            name = "index.html"
        else:
            self.xsrf_token  # noqa: B018  sets its cookie
            name = "index.html" if self.session else "login.html"
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(FILES[name].read_bytes())


class File(Guarded):
    """One of the page's own files; they hold no secrets."""

    open_to_all = True

    def get(self, name: str) -> None:
        """Send it."""
        path = FILES.get(name)
        if path is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Cache-Control", "no-cache")
        self.set_header("Content-Type", f"{TYPES[path.suffix]}; charset=utf-8")
        self.finish(path.read_bytes())


class Session(Guarded):
    """Who this page is: asked before it looks on, so that it comes back by itself."""

    open_to_all = True

    def get(self) -> None:
        """Send it; on this computer, begin a session where there is none (any more)."""
        if self.session is None:
            if not self.is_from_here():
                raise tornado.web.HTTPError(401)
            self.begin_session(self.sessions.open("operator", self.request.remote_ip or ""))
        self.set_header("Content-Type", "application/json")
        self.finish("{}")


class Language(Guarded):
    """A catalogue of the page's words."""

    open_to_all = True

    def get(self, name: str) -> None:
        """Send it."""
        if name not in LANGUAGES:
            raise tornado.web.HTTPError(404)
        self.set_header("Cache-Control", "no-cache")
        self.set_header("Content-Type", "application/json; charset=utf-8")
        self.finish(json.dumps(dict(catalogue(name)), ensure_ascii=False))


class LogIn(Guarded):
    """A token for a session."""

    open_to_all = True
    tell_tokens: Any

    def post(self) -> None:
        """Take the token."""
        require_origin(self.request, self.hosts)
        if self.sessions.locked:
            raise tornado.web.HTTPError(429)
        token = self.get_body_argument("token", "")
        opened = self.sessions.redeem(token, self.request.remote_ip or "")
        if opened is None:
            raise tornado.web.HTTPError(403)
        self.tell_tokens(opened[1])
        self.begin_session(opened[0])
        self.redirect("/", status=303)


def require_origin(request: HTTPServerRequest, hosts: Hosts) -> None:
    """Raise HTTPError where no Origin is told, or another one than this page."""
    if not hosts.is_origin(request.headers.get("Origin"), request.headers.get("Host")):
        raise tornado.web.HTTPError(403)


class CommandPost(Guarded):
    """A command: POST with Origin, session, XSRF header and JSON."""

    desk: Desk

    async def post(self) -> None:
        """Take it, answer accepted or refused."""
        require_origin(self.request, self.hosts)
        kind = self.request.headers.get("Content-Type", "").partition(";")[0].strip()
        if kind != "application/json":
            raise tornado.web.HTTPError(415)
        assert self.session is not None  # `prepare` has looked
        try:
            command = parse(self.request.body)
        except InputError as error:
            self.set_status(400)
            told = said_of(of_error(error)).to_json_dict()
            self.finish({"accepted": False, "said": told})
            return
        answer = await self.desk.take(self.session, command)
        self.finish(answer.to_json_dict())


class Picture(Guarded):
    """The newest picture."""

    content: Content

    def get(self) -> None:
        """Send it."""
        jpeg = self.content.picture()
        if jpeg is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", "image/jpeg")
        self.finish(jpeg)


class HandoverFile(Guarded):
    """The pose as a file for a control out of a fixed list."""

    content: Content

    def get(self, control: str) -> None:
        """Send it."""
        made = self.content.handover_file(control)
        if made is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.set_header("Content-Disposition", f'attachment; filename="{made[0]}"')
        self.finish(made[1])


class ReportFile(Guarded):
    """The newest report."""

    content: Content

    def get(self) -> None:
        """Send it."""
        pdf = self.content.report_file()
        if pdf is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", "application/pdf")
        self.set_header("Content-Disposition", 'inline; filename="report.pdf"')
        self.finish(pdf)


class Missing(Guarded):
    """All other addresses."""

    open_to_all = True

    def prepare(self) -> None:
        """Refuse strangers, then say that there is nothing."""
        refuse_foreign(self.request, self.hosts)
        raise tornado.web.HTTPError(404)
