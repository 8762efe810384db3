"""Whether the scans of a JPEG are all there, by what its headers promise (ITU-T T.81, B.2, G.1).

Two cuts leave a file that decodes without reading past its end: one at a restart marker (the rest
is grey), and one between the scans of a progressive image (coarser than it was taken).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_FRAMES = {0xC0, 0xC1, 0xC2, 0xC9, 0xCA}
_PROGRESSIVE = {0xC2, 0xCA}
_ALONE = {0x01, *range(0xD0, 0xD9)}
_NOISE_BEFORE_RESTART = 512


@dataclass(kw_only=True)
class Frame:
    """What the headers have said so far."""

    progressive: bool = False
    width: int = 0
    height: int = 0
    sampling: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Horizontal and vertical, by component."""
    interval: int = 0
    """MCUs between two restart markers; 0 without them."""
    precision: dict[tuple[int, int], int] = field(default_factory=dict)
    """Lowest bit that has come, by component and coefficient."""


@dataclass(frozen=True, kw_only=True)
class Scans:
    """What was found."""

    trouble: str
    """What is missing; empty where nothing is."""
    restarts: tuple[int, ...]
    """Where restart markers stand."""

    def with_noise(self, data: bytes, noise: bytes) -> bytes:
        """Return the image with noise before each restart marker: a whole one never reads it."""
        places = (0, *self.restarts)
        pieces = [data[a:b] for a, b in zip(places, (*self.restarts, len(data)))]
        return noise[:_NOISE_BEFORE_RESTART].join(pieces)


def scans_of(data: bytes) -> Scans:
    """Look through a JPEG that ends with its end marker."""
    frame, restarts, at = Frame(), [], 2
    trouble = ""
    while at + 4 <= len(data):
        at = data.find(b"\xff", at)
        marker = data[at + 1] if 0 <= at < len(data) - 1 else 0xD9
        if marker == 0xD9:
            break
        if marker in (0x00, 0xFF) or marker in _ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        body = data[at + 4 : at + 2 + length]
        at += 2 + length
        if marker in _FRAMES:
            _read_frame(frame, marker, body)
        elif marker == 0xDD and len(body) >= 2:
            frame.interval = int.from_bytes(body[:2], "big")
        elif marker == 0xDA:
            found, at = _restarts(data, at)
            restarts += found
            trouble = trouble or _scan(frame, body, [data[i + 1] & 7 for i in found])
    return Scans(trouble=trouble or _missing(frame), restarts=tuple(restarts))


def _read_frame(frame: Frame, marker: int, body: bytes) -> None:
    frame.progressive = marker in _PROGRESSIVE
    frame.height, frame.width = (int.from_bytes(body[i : i + 2], "big") for i in (1, 3))
    for i in range(6, len(body) - 2, 3):
        frame.sampling[body[i]] = body[i + 1] >> 4, body[i + 1] & 15


def _restarts(data: bytes, at: int) -> tuple[list[int], int]:
    """Return the restart markers of a scan, and where it ends."""
    found = []
    while (at := data.find(b"\xff", at)) >= 0 and at + 1 < len(data):
        marker = data[at + 1]
        if 0xD0 <= marker <= 0xD7:
            found.append(at)
        elif marker not in (0x00, 0xFF):
            return found, at
        at += 1 if marker == 0xFF else 2
    return found, len(data)


def _scan(frame: Frame, body: bytes, counts: list[int]) -> str:
    """Note what a scan brings; return what is wrong with its restart markers."""
    if not body or len(body) < 4 + 2 * body[0]:
        return "a scan has no header"
    components = [body[1 + 2 * i] for i in range(body[0])]
    first, last, bits = body[-3:]
    for component in components:
        for k in range(first, last + 1):
            frame.precision[component, k] = bits & 15
    if not frame.interval or not frame.height:  # a height of 0 is told behind the scan
        return ""
    wanted = math.ceil(_mcus(frame, components) / frame.interval) - 1
    if counts != [i % 8 for i in range(wanted)]:
        return f"{len(counts)} of {wanted} restart markers are there, or not in their order"
    return ""


def _mcus(frame: Frame, components: list[int]) -> int:
    """Return how many MCUs a scan has (A.2.2, A.2.3)."""
    sizes = list(frame.sampling.values()) or [(1, 1)]
    most_h, most_v = (max(max(1, s[i]) for s in sizes) for i in (0, 1))
    if len(components) > 1:
        return math.ceil(frame.width / (8 * most_h)) * math.ceil(frame.height / (8 * most_v))
    h, v = frame.sampling.get(components[0], (1, 1))
    return math.ceil(math.ceil(frame.width * h / most_h) / 8) * math.ceil(
        math.ceil(frame.height * v / most_v) / 8
    )


def _missing(frame: Frame) -> str:
    """Return what of a progressive image never came."""
    if not frame.progressive:
        return ""
    wanted = [(c, k) for c in frame.sampling for k in range(64)]
    rest = sum(frame.precision.get(key, 1) != 0 for key in wanted)
    return f"{rest} of {len(wanted)} coefficients never came to their last bit" if rest else ""
