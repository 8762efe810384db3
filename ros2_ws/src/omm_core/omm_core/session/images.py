"""What was seen in one image, where the spindle stood then, and whether that can be used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.session.pairing import PairedPose
from omm_core.words import Words


class FoundTarget(Protocol):
    """What a measurement needs to know of a detected target."""

    @property
    def id(self) -> int:
        """Number in the family."""

    @property
    def center_px(self) -> Any:
        """(col, row)."""

    @property
    def covariance_px2(self) -> Any:
        """(2, 2)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenTarget:
    """One target in one image, as numbers that can be compared."""

    target_id: int
    center_px: tuple[float, float]
    covariance_px2: tuple[float, float, float, float]


Content = tuple[SeenTarget, ...] | Words
"""What an image shows, or why it could not be used at all."""


def content_of(targets: Iterable[FoundTarget]) -> tuple[SeenTarget, ...]:
    """Return the targets as they are compared: by number and place."""
    seen = (
        SeenTarget(
            target_id=int(target.id),
            center_px=_floats(target.center_px),
            covariance_px2=_floats(target.covariance_px2),
        )
        for target in targets
    )
    return tuple(sorted(seen, key=lambda s: (s.target_id, s.center_px)))


def same_content(one: Content, other: Content) -> bool:
    """Tell whether two images show the same, to the last digit."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return [(s.target_id, s.center_px) for s in one] == [(s.target_id, s.center_px) for s in other]


def targets_in(versions: Iterable[Content]) -> tuple[SeenTarget, ...]:
    """Return the targets in what carries one stamp; none where two images do."""
    shown = [content for content in versions if not isinstance(content, str)]
    return shown[0] if len(shown) == 1 else ()


@dataclass(frozen=True, kw_only=True, eq=False)
class JudgedImage:
    """One image of a measurement, and all that is known of it before solving.

    Attributes
    ----------
    stamp_ns : int
    seen : tuple of SeenTarget
        By number; those that are no targets of the part, too.
    pose : PairedPose
        Where the spindle stood, or why that is not known.
    refused : Words or None
        Why the image cannot be used; None where it can.
    """

    stamp_ns: int
    seen: tuple[SeenTarget, ...]
    pose: PairedPose
    refused: Words | None

    @property
    def machine_T_spindle(self) -> RigidTransform:
        """Where the spindle stood, of an image that is not refused."""
        assert self.refused is None
        assert self.pose.machine_T_spindle is not None
        return self.pose.machine_T_spindle

    def usable(self, part: Part) -> list[SeenTarget]:
        """Return the part's targets whose number was found once."""
        ids = [seen.target_id for seen in self.seen]
        return [
            seen
            for seen in self.seen
            if part.target(seen.target_id) and ids.count(seen.target_id) == 1
        ]


def _floats(values: Any) -> Any:
    return tuple(float(value) for value in np.asarray(values, dtype=float).ravel())
