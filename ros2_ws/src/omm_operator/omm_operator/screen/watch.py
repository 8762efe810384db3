"""Who has been heard, and when: what falls silent is told within two seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

# Nodes say how they are once a second; told at the latest 2 s after they died.
LIMIT_S = 1.9
# A station that is being started is not well yet, and nothing is wrong with it.
STARTING_S = 5.0
SOURCES = ("estimator", "camera", "bridge", "control", "recorder")

State = Literal["waiting", "ok", "fault", "silent"]


@dataclass(frozen=True, kw_only=True)
class Source:
    """How one station is: ``age_s`` since it was last heard, None where it never was."""

    name: str
    state: State
    age_s: float | None
    detail: str = ""


@dataclass(frozen=True, kw_only=True)
class _Heard:
    at_s: float
    fine: bool
    detail: str
    left: bool = False


class Watch:
    """Remembers when each station was heard and what it said.

    Parameters
    ----------
    limit_s : float
        Silence after which a station counts as gone.
    """

    def __init__(self, limit_s: float = LIMIT_S) -> None:
        self._limit_s = limit_s
        self._heard: dict[str, _Heard] = {}
        self._starting: dict[str, float] = {}

    def hear(self, name: str, now_s: float, *, fine: bool = True, detail: str = "") -> None:
        """Take a sign of life, and whether the station says that it is well."""
        before = self._heard.get(name)
        if fine:
            self._starting[name] = -math.inf
        elif before is None or (before.left and not before.fine):
            self._starting[name] = now_s
        self._heard[name] = _Heard(at_s=now_s, fine=fine, detail=detail)

    def lose(self, name: str) -> None:
        """Take that a station has left: it is silent from now on, without waiting."""
        if name in self._heard:
            self._heard[name] = replace(self._heard[name], left=True)

    def source(self, name: str, now_s: float) -> Source:
        """Return how a station is now."""
        heard = self._heard.get(name)
        if heard is None:
            return Source(name=name, state="waiting", age_s=None)
        age_s = max(0.0, now_s - heard.at_s)
        if heard.left or age_s > self._limit_s:
            return Source(name=name, state="silent", age_s=age_s, detail=heard.detail)
        starting = now_s - self._starting.get(name, -math.inf) < STARTING_S
        state: State = "ok" if heard.fine else "waiting" if starting else "fault"
        return Source(name=name, state=state, age_s=age_s, detail=heard.detail)

    def well(self, name: str, now_s: float) -> bool:
        """Return whether a station was heard just now and says that it is well."""
        return self.source(name, now_s).state == "ok"
