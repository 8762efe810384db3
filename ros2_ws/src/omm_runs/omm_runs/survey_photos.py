"""Which photographs of a survey take part, and why others do not: one camera, each picture once."""

from __future__ import annotations

from collections import Counter

import numpy as np

from omm_core.errors import MeasurementError
from omm_core.files.survey import SurveySet
from omm_runs.photographs import Seen, taken_with

FEWEST_PHOTOS = 3

_SAME_PX, _FEWEST_SAME = 0.1, 4  # of the targets in two photographs: median distance, and how many
_SHARE_SAME = 0.8  # of the targets of either


def photos_left_out(given: SurveySet, seen: list[Seen], size_px: tuple[int, int]) -> dict[int, str]:
    """Return why photographs do not take part, by number.

    Raises
    ------
    MeasurementError
        Where too few are left.
    """
    reasons: dict[int, str] = {}
    for number, (photo, found) in enumerate(zip(given.photos, seen, strict=True)):
        if photo in given.left_out:
            reasons[number] = "survey.yaml says so (leave_out)"
        elif found.problem is not None:
            reasons[number] = found.problem
        elif found.size_px != size_px:
            reasons[number] = _other_size(found.size_px, size_px)
        elif not found.targets:
            reasons[number] = f"no coded target of {given.target_family} was read in it"
    reasons |= _other_camera(given, [n for n in range(len(seen)) if n not in reasons])
    reasons |= _copies(given, seen, [n for n in range(len(seen)) if n not in reasons])
    left = len(seen) - len(reasons)
    if left < FEWEST_PHOTOS:
        told = "; ".join(f"{given.photos[n].name}: {why}" for n, why in list(reasons.items())[:5])
        raise MeasurementError(
            f"Expected {FEWEST_PHOTOS} photographs or more with coded targets, got {left}. {told}."
        )
    return reasons


def doubled_numbers(seen: dict[str, Seen]) -> tuple[set[int], list[str]]:
    """Return numbers that stand on two targets, and what must be told of what is read twice.

    Which of the two a ray belongs to is not known where a photograph shows only one of them.

    Parameters
    ----------
    seen : mapping
        By the name of the photograph.
    """
    where: dict[int, list[str]] = {}
    for name, found in seen.items():
        for number in found.twice:
            where.setdefault(number, []).append(name)
    doubled = {number for number, names in where.items() if len(names) > 1}
    words = []
    for number, names in sorted(where.items()):
        if number in doubled:
            words.append(
                f"Target {number} is left out: {len(names)} photographs ({names[0]},"
                f" {names[1]} ...) show its number twice, so it stands on two targets. Cover one."
            )
        else:
            words.append(
                f"{names[0]}: target {number} is read twice in it and left out there; one is a"
                " reflection or another target read wrong."
            )
    return doubled, words


def _other_size(size: tuple[int, int], usual: tuple[int, int]) -> str:
    words = f"it has {size[0]} x {size[1]} pixels, the camera's others {usual[0]} x {usual[1]}"
    if size == usual[::-1]:
        return words + ": a program turned its pixels; give the file as the camera wrote it"
    return words + ": it was cut, made smaller, or taken by another camera"


def _other_camera(given: SurveySet, numbers: list[int]) -> dict[int, str]:
    """Return the photographs whose EXIF names another camera or lens than that of most."""
    told = {n: taken_with(given.photos[n]) for n in numbers}
    known = [camera for camera in told.values() if any(camera)]
    if len(set(known)) < 2:
        return {}
    usual = Counter(known).most_common(1)[0][0]
    return {
        n: f"it was taken with another camera or lens ({_name(camera)}; most with {_name(usual)}),"
        " and one survey takes one: survey its photographs as a set of their own"
        for n, camera in told.items()
        if any(a and b and a != b for a, b in zip(camera, usual, strict=True))
    }


def _name(camera: tuple[str, ...]) -> str:
    return ", ".join(word for word in camera if word)


def _copies(given: SurveySet, seen: list[Seen], numbers: list[int]) -> dict[int, str]:
    """Return the photographs that show nothing but what another one shows at the same places.

    Rays that are counted twice would make all standard deviations too small.
    """
    places = {n: {t.id: t.center_px for t in seen[n].targets} for n in numbers}
    copies: dict[int, str] = {}
    for k, later in enumerate(numbers):
        for earlier in numbers[:k]:
            if earlier not in copies and _same(places[earlier], places[later]):
                copies[later] = (
                    f"it shows the targets where {given.photos[earlier].name} does: a copy, or"
                    " taken without moving the camera"
                )
                break
    return copies


def _same(one: dict[int, np.ndarray], two: dict[int, np.ndarray]) -> bool:
    common = one.keys() & two.keys()
    if len(common) < max(_FEWEST_SAME, _SHARE_SAME * max(len(one), len(two))):
        return False
    apart = [np.linalg.norm(one[n] - two[n]) for n in common]
    return bool(np.median(apart) < _SAME_PX)
