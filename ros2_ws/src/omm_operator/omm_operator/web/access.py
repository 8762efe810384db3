"""Who may look and who may command: hosts, origins, sessions, one-time tokens. No network here.

On loopback whoever reaches the port gets an operator's session; it is still a cookie, so that a
page of somebody else in the same browser (another origin, a name rebound to 127.0.0.1) has none of
it. From another computer a session costs a token, which is good for one use.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from omm_operator.screen.commands import ROLES
from omm_operator.screen.desk import Asker

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_LARGEST_SESSIONS = 200
_ATTEMPTS, _ATTEMPTS_S = 10, 60.0
# Without those that look like others; 16 of 31 are 79 bits.
_ALPHABET = "abcdefghjkmnpqrstuvwxyz23456789"


class Hosts:
    """The names by which this page may be called, and the origins that follow from them.

    Parameters
    ----------
    names : iterable of str
        Besides those of loopback; without port.
    port : int
        Port of the page.
    secure : bool
        Whether the page is served by https.
    """

    def __init__(self, names: Iterable[str], port: int, *, secure: bool) -> None:
        self._scheme = "https" if secure else "http"
        self._default = 443 if secure else 80
        self._port = port
        self._names = {name.lower() for name in (*LOOPBACK_NAMES, *names)}

    def knows(self, host: str | None) -> bool:
        """Return whether a Host header is one of ours, port included."""
        if not host or any(c in host for c in "/@?#\\ \t,"):
            return False
        name, port = _split(host, self._default)
        return name.lower() in self._names and port == self._port

    def is_origin(self, origin: str | None, host: str | None) -> bool:
        """Return whether an Origin header is this page itself, as it was called in Host."""
        if not origin or not host or not self.knows(host):
            return False
        return origin.lower() == f"{self._scheme}://{host.lower()}"


def _split(host: str, default: int) -> tuple[str, int]:
    name, colon, port = host.rpartition(":")
    if not colon or host.endswith("]"):
        return host, default
    return (name, int(port)) if port.isascii() and port.isdigit() and len(port) < 6 else (host, -1)


def is_loopback(address: str | None) -> bool:
    """Return whether an address of a peer is this computer itself."""
    try:
        parsed = ipaddress.ip_address(address or "")
    except ValueError:
        return False
    mapped = getattr(parsed, "ipv4_mapped", None)
    return bool((mapped or parsed).is_loopback)


class Sessions:
    """Sessions by their secret, which only the browser knows.

    Parameters
    ----------
    clock : callable
        Seconds, monotonic.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._sessions: OrderedDict[str, Asker] = OrderedDict()
        self._tokens = {role: _new_token() for role in ROLES}
        self._failed: deque[float] = deque(maxlen=_ATTEMPTS)

    def open(self, role: str, address: str) -> str:
        """Open a session and return its secret."""
        secret = secrets.token_urlsafe(32)
        self._sessions[secret] = Asker(who=f"{address} {secrets.token_hex(3)}", role=role)
        while len(self._sessions) > _LARGEST_SESSIONS:
            self._sessions.popitem(last=False)
        return secret

    def find(self, secret: str | None) -> Asker | None:
        """Return whose session a secret is."""
        asker = self._sessions.get(secret) if secret else None
        if asker is not None and secret is not None:
            self._sessions.move_to_end(secret)
        return asker

    def close(self, secret: str | None) -> None:
        """End a session."""
        self._sessions.pop(secret or "", None)

    @property
    def locked(self) -> bool:
        """Whether too many wrong tokens came within the last minute."""
        full = len(self._failed) == _ATTEMPTS
        return full and self._clock() - self._failed[0] < _ATTEMPTS_S

    def redeem(self, token: str, address: str) -> tuple[str, Asker] | None:
        """Open a session for a token, which is used up by it; None where it is none of ours."""
        if self.locked:
            return None
        given = token.strip().lower().replace("-", "").encode("utf-8", "replace")
        for role, known in self._tokens.items():
            if hmac.compare_digest(given, known.encode()):
                self._tokens[role] = _new_token()
                secret = self.open(role, address)
                return secret, self._sessions[secret]
        self._failed.append(self._clock())
        return None

    def tokens(self) -> dict[str, str]:
        """Return the token of each role that is good now, in groups of four."""
        return {
            role: "-".join(token[i : i + 4] for i in range(0, len(token), 4))
            for role, token in self._tokens.items()
        }


@dataclass(frozen=True, kw_only=True)
class Listening:
    """Where the page listens, and by which names it may be called there."""

    address: str
    port: int
    hosts: tuple[str, ...]
    secure: bool

    @property
    def alone(self) -> bool:
        """Whether only this computer reaches it."""
        return is_loopback(self.address)

    def names(self) -> tuple[str, ...]:
        """Return the names besides those of loopback: what was given, and a certain address."""
        wild = self.address in ("0.0.0.0", "::", "")
        literal = f"[{self.address}]" if ":" in self.address else self.address
        return (*self.hosts, *(() if wild else (literal,)))


def _new_token() -> str:
    return "".join(secrets.choice(_ALPHABET) for _ in range(16))
