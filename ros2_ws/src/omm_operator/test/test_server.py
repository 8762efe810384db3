"""The page's server over real sockets: who is answered, and who is not."""

import base64
import contextlib
import http.client
import json
import re
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from omm_core.errors import InputError
from omm_operator.operating import Operation, Refused
from omm_operator.screen.facts import EstimateFact, OffsetFact
from omm_operator.screen.handing import HandingOptions
from omm_operator.screen.screen import Screen
from omm_operator.web import serving
from omm_operator.web.access import Hosts, Sessions, is_loopback
from omm_operator.web.application import application
from omm_operator.web.handlers import COOKIE, FILES
from omm_operator.web.live import finite
from omm_operator.web.serving import ServerThread, listen, tls_context

PAGE_LIMIT = 300_000


class Nobody:
    """Nodes that refuse everything."""

    async def start_program(self) -> None:
        raise Refused("nobody is there")

    async def new_clamping(self) -> None:
        raise Refused("nobody is there")

    async def work_offset(self, name: str, wanted: OffsetFact | None) -> OffsetFact:
        raise Refused("nobody is there")

    async def report(self, language: str) -> bytes:
        raise Refused("nobody is there")


class Served:
    """A page that is served, and a browser of sorts."""

    def __init__(self, names: tuple[str, ...] = (), context: ssl.SSLContext | None = None) -> None:
        sockets, self.port = listen("127.0.0.1", 0)
        self.recorded: list[tuple[str, str, object]] = []
        screen = Screen(options=HandingOptions(), wall_ns=time.time_ns, clock_s=time.monotonic)
        self.operation = Operation(screen, Nobody(), self._record)
        self.sessions = Sessions(time.monotonic)
        self.hosts = Hosts(names, self.port, secure=context is not None)
        self.context = context
        self.server = ServerThread(sockets, context, self._make)
        self.server.start()

    def _make(self) -> object:
        made, pages = application(
            self.operation, self.operation.desk, self.hosts, self.sessions,
            tell_tokens=lambda asker: None, language="en",
        )  # fmt: skip
        self.operation.show_with(pages.show)
        return made

    def _record(self, asker: Any, command: Any, answer: Any) -> None:
        self.recorded.append((asker.role, command.name, answer and answer.accepted))

    def ask(
        self, method: str, path: str, headers: dict[str, str] | None = None, body: bytes = b""
    ) -> tuple[int, dict[str, str], bytes]:
        """One request; `Host` is the page's own unless the headers say another."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        with contextlib.closing(connection):
            sent = {"Host": f"127.0.0.1:{self.port}"} | (headers or {})
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                connection.putheader(name, value)
            connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            answer = connection.getresponse()
            cookies = "; ".join(c.partition(";")[0] for c in answer.msg.get_all("Set-Cookie") or [])
            told = {name.lower(): value for name, value in answer.getheaders()}
            return answer.status, told | {"cookies": cookies}, answer.read()

    def origin(self, host: str = "127.0.0.1") -> str:
        return f"http://{host}:{self.port}"

    def session(self) -> dict[str, str]:
        """Headers of a page that was opened on this computer."""
        status, told, _ = self.ask("GET", "/")
        assert status == 200
        return self.with_cookies(told["cookies"])

    def with_cookies(self, cookies: str) -> dict[str, str]:
        xsrf = re.search(r"_xsrf=([^;]+)", cookies)
        assert xsrf is not None
        return {
            "Cookie": cookies,
            "X-XSRFToken": xsrf[1],
            "Origin": self.origin(),
            "Content-Type": "application/json",
        }

    def command(self, headers: dict[str, str], name: str = "acknowledge") -> tuple[int, bytes]:
        arguments = {"number": 0} if name == "acknowledge" else {}
        body = {"command": name, "key": f"key-{time.time_ns()}", "arguments": arguments}
        status, _, content = self.ask("POST", "/command", headers, json.dumps(body).encode())
        return status, content

    def handshake(self, headers: dict[str, str]) -> int:
        """Status of opening the live state: 101 where it is opened."""
        upgrade = {
            "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": base64.b64encode(b"0123456789abcdef").decode(),
        }  # fmt: skip
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        with contextlib.closing(connection):
            sent = {"Host": f"127.0.0.1:{self.port}"} | upgrade | headers
            connection.putrequest("GET", "/live", skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                connection.putheader(name, value)
            connection.endheaders()
            answer = connection.getresponse()
            answer.close()
            return answer.status


@pytest.fixture
def served() -> Iterator[Served]:
    page = Served(names=("mill-pc",))
    yield page
    page.server.close()


def without(headers: dict[str, str], *names: str) -> dict[str, str]:
    return {name: value for name, value in headers.items() if name not in names}


def test_a_command_from_the_page_itself_is_taken(served: Served) -> None:
    status, content = served.command(served.session())
    assert status == 200
    assert json.loads(content)["accepted"] is True
    assert served.recorded == [("operator", "acknowledge", None), ("operator", "acknowledge", True)]


FOREIGN_ORIGINS = [
    "http://evil.example", "null", "", "https://127.0.0.1:{port}", "http://127.0.0.1:1",
    "http://127.0.0.1:{port}.evil.example", "http://evil.example:{port}",
    "http://localhost:{port}", "http://127.0.0.1:{port}/", "http://x@127.0.0.1:{port}",
]  # fmt: skip


@pytest.mark.parametrize("origin", FOREIGN_ORIGINS)
def test_a_command_from_another_origin_is_refused(served: Served, origin: str) -> None:
    headers = served.session() | {"Origin": origin.format(port=served.port)}
    assert served.command(headers)[0] == 403
    assert served.handshake(headers) == 403
    assert served.recorded == []


def test_a_command_without_origin_session_or_token_is_refused(served: Served) -> None:
    headers = served.session()
    assert served.command(without(headers, "Origin"))[0] == 403
    assert served.command(without(headers, "X-XSRFToken"))[0] == 403
    assert served.command(without(headers, "Content-Type"))[0] == 415
    xsrf_only = re.sub(rf"{COOKIE}=[^;]+(; )?", "", headers["Cookie"])
    assert served.command(headers | {"Cookie": xsrf_only})[0] == 401
    assert served.command(headers | {"Cookie": f"{COOKIE}=guess; {xsrf_only}"})[0] == 401
    assert served.recorded == []


HOSTS = [
    "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost:{port}.evil.example",
    "evil.example", "", "127.0.0.1:{port}@evil.example", "127.0.0.2:{port}", "[::1]", "mill-pc",
    "mill-pc:{port}, 127.0.0.1:{port}",
]  # fmt: skip


@pytest.mark.parametrize("host", HOSTS)
@pytest.mark.parametrize("path", ["/", "/file/app.js", "/session", "/picture.jpg", "/nothing"])
def test_another_host_is_refused_whatever_it_asks_for(served: Served, host: str, path: str) -> None:
    """A name that is rebound to 127.0.0.1 comes with Host and Origin of that name."""
    named = host.format(port=served.port)
    headers = served.session() | {"Host": named, "Origin": f"http://{named}"}
    status, told, _ = served.ask("GET", path, headers)
    assert status in (400, 421)
    assert COOKIE not in told["cookies"]


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]", "mill-pc", "MILL-PC"])
def test_the_names_of_the_page_are_answered(served: Served, name: str) -> None:
    status, _, _ = served.ask("GET", "/", {"Host": f"{name}:{served.port}"})
    assert status == 200


def test_the_live_state_needs_origin_and_session(served: Served) -> None:
    headers = served.session()
    assert served.handshake(headers) == 101
    assert served.handshake(without(headers, "Origin")) == 403
    assert served.handshake(without(headers, "Cookie")) == 401
    rebound = {
        "Host": f"evil.example:{served.port}",
        "Origin": f"http://evil.example:{served.port}",
    }
    assert served.handshake(headers | rebound) == 421


def test_another_site_may_go_to_the_page_but_not_look_into_it(served: Served) -> None:
    headers = served.session()
    for site in ("cross-site", "same-site"):
        embedded = headers | {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
        for path in ("/session", "/picture.jpg", "/report.pdf", "/file/app.js", "/"):
            assert served.ask("GET", path, without(embedded, "Origin"))[0] == 403
        assert served.handshake(embedded | {"Sec-Fetch-Mode": "websocket"}) == 403
        gone_to = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate"}
        assert served.ask("GET", "/", gone_to)[0] == 200
    same = headers | {"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}
    assert served.ask("GET", "/session", same)[0] == 200


def test_no_number_that_a_browser_cannot_read_is_sent() -> None:
    state = {"a": [1.0, float("nan")], "b": {"c": (float("inf"), "NaN", None, 2)}}
    assert finite(state) == {"a": [1.0, None], "b": {"c": [None, "NaN", None, 2]}}


PATHS = [
    "/file/../operating.py", "/file/..%2foperating.py", "/file/%2e%2e/node.py", "/file/style.css/",
    "/file/passwd", "/language/xx.json", "/language/../en.json", "/handover/evil",
    "/handover/linuxcnc%0a", "/picture.jpg", "/report.pdf", "/../../etc/passwd",
]  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_no_path_leads_out_of_the_page(served: Served, path: str) -> None:
    status, _, content = served.ask("GET", path, served.session())
    assert status == 404
    assert len(content) < 100


def test_the_session_is_a_cookie_that_no_script_and_no_other_site_gets(served: Served) -> None:
    _, told, _ = served.ask("GET", "/")
    cookie = served_cookie(served)
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    policy = told["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "server" not in told


def served_cookie(served: Served) -> str:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=10)
    with contextlib.closing(connection):
        connection.request("GET", "/")
        answer = connection.getresponse()
        answer.read()
        (cookie,) = [c for c in answer.msg.get_all("Set-Cookie") or [] if c.startswith(COOKIE)]
        return cookie


def test_a_request_that_is_never_finished_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "IDLE_S", 0.2)
    page = Served()
    with socket.create_connection(("127.0.0.1", page.port), timeout=10.0) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1")
        assert slow.recv(1) == b""
    page.server.close()


def test_a_token_of_another_computer_is_good_once_and_has_its_role() -> None:
    sessions = Sessions(time.monotonic)
    tokens = sessions.tokens()
    assert set(tokens) == {"viewer", "operator"}
    for role, token in tokens.items():
        opened = sessions.redeem(f" {token.upper()} ", "10.0.0.7")
        assert opened is not None
        assert (opened[1].role, sessions.find(opened[0])) == (role, opened[1])
        assert sessions.redeem(token, "10.0.0.7") is None
    assert sessions.tokens() != tokens


def test_guessing_a_token_is_slowed_down() -> None:
    now_s = [0.0]
    sessions = Sessions(lambda: now_s[0])
    for _ in range(10):
        assert sessions.redeem("aaaa-aaaa-aaaa-aaaa", "10.0.0.7") is None
    assert sessions.locked
    assert sessions.redeem(sessions.tokens()["viewer"], "10.0.0.7") is None
    now_s[0] = 61.0
    assert sessions.redeem(sessions.tokens()["viewer"], "10.0.0.7") is not None


def test_a_log_in_from_another_origin_is_refused_although_its_token_is_good(
    served: Served,
) -> None:
    _, told, _ = served.ask("GET", "/")
    headers = served.with_cookies(told["cookies"])
    headers |= {"Content-Type": "application/x-www-form-urlencoded"}
    body = f"token={served.sessions.tokens()['viewer']}".encode()
    foreign = headers | {"Origin": "http://evil.example"}
    assert served.ask("POST", "/login", foreign, body)[0] == 403
    status, told, _ = served.ask("POST", "/login", headers, body)
    assert (status, told["location"]) == (303, "/")
    viewer = served.with_cookies(f"{told['cookies']}; {headers['Cookie'].partition('; ')[2]}")
    status, content = served.command(viewer)
    assert (status, json.loads(content)["accepted"]) == (200, False)
    assert served.recorded == [("viewer", "acknowledge", False)]


@pytest.mark.parametrize(
    ("address", "expected"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("::ffff:127.0.0.1", True),
     ("10.0.0.7", False), ("::ffff:10.0.0.7", False), ("fe80::1", False), ("", False),
     (None, False)],
)  # fmt: skip
def test_only_this_computer_is_this_computer(address: str | None, expected: bool) -> None:
    assert is_loopback(address) is expected


def test_what_a_node_refuses_is_answered_and_stays_in_the_list(served: Served) -> None:
    headers = served.session()
    kept = served.operation.screen
    kept.watch.hear("estimator", time.monotonic())
    status, content = served.command(headers, "new_clamping")
    answer = json.loads(content)
    assert (status, answer["accepted"]) == (200, False)
    assert answer["said"]["text"] == "nobody is there"
    assert [t.said.key for t in kept.troubles.all()] == ["trouble.refused_new_clamping"]


def test_a_body_that_is_too_large_or_no_command_is_refused(served: Served) -> None:
    headers = served.session()
    for body in (b"x" * 10_000, b"{}", b"\xff\xfe"):
        status, _, _ = served.ask("POST", "/command", headers, body)
        assert status == 400


def test_a_file_for_a_control_is_sent_only_while_there_is_a_pose(served: Served) -> None:
    headers = served.session()
    assert served.ask("GET", "/handover/siemens", headers)[0] == 404
    import numpy as np

    theta = np.array([0.0, 0.0, 0.1, 1.0, 2.0, 3.0, 0.0])
    served.operation.screen.kept.estimate = EstimateFact(
        part="bed", determined=True, converged=True, theta=theta,
        covariance=np.eye(7), expanded_uncertainty=np.ones(7),
    )  # fmt: skip
    status, told, content = served.ask("GET", "/handover/siemens", headers)
    assert status == 200
    assert told["content-disposition"] == 'attachment; filename="omm-siemens.mpf"'
    assert b"$P_UIFR[1] = CTRANS(X,1.000000" in content
    assert served.ask("GET", "/handover/siemens", without(headers, "Cookie"))[0] == 401


def test_the_page_needs_nobody_else_and_is_small() -> None:
    sizes = 0
    for path in FILES.values():
        content = path.read_text(encoding="utf-8")
        sizes += len(content.encode())
        foreign = set(re.findall(r"https?://[^\s\"'`<>)]+", content))
        assert foreign <= {"http://www.w3.org/2000/svg"}, path.name
    assert sizes <= PAGE_LIMIT


def test_a_port_that_is_taken_is_told(served: Served) -> None:
    with pytest.raises(InputError, match="port"):
        listen("127.0.0.1", served.port)


def test_with_the_shops_certificate_the_page_is_https(tmp_path: Path) -> None:
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
         "-nodes", "-days", "2", "-subj", "/CN=localhost",
         "-addext", "subjectAltName=DNS:localhost",
         "-keyout", str(key), "-out", str(certificate)],
        check=True, capture_output=True,
    )  # fmt: skip
    served = Served(context=tls_context(str(certificate), str(key)))
    trusting = ssl.create_default_context(cafile=str(certificate))
    connection = http.client.HTTPSConnection("localhost", served.port, context=trusting, timeout=10)
    with contextlib.closing(connection):
        connection.request("GET", "/")
        answer = connection.getresponse()
        answer.read()
        cookies = answer.msg.get_all("Set-Cookie") or []
    served.server.close()
    assert answer.status == 200
    assert all("Secure" in c for c in cookies if c.startswith(COOKIE))


def test_half_a_certificate_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="both"):
        tls_context(str(tmp_path / "certificate.pem"), "")
    (tmp_path / "certificate.pem").write_text("no certificate")
    (tmp_path / "key.pem").write_text("no key")
    with pytest.raises(InputError, match="certificate"):
        tls_context(str(tmp_path / "certificate.pem"), str(tmp_path / "key.pem"))


def test_what_ends_the_servers_thread_is_known_to_who_started_it() -> None:
    def make() -> object:
        raise RuntimeError("a defect")

    sockets, _ = listen("127.0.0.1", 0)
    server = ServerThread(sockets, None, make)
    server.start()
    assert str(server.failure) == "a defect"
    server.close()
    for each in sockets:
        each.close()
