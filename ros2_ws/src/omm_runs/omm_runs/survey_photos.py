"""Which photographs of a survey take part, and why others do not: each picture once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from omm_core.errors import MeasurementError
from omm_core.files.survey import SurveySet
from omm_runs.photographs import Seen, focal_length_px
from omm_runs.survey_cameras import FEWEST_OF_CAMERA, Group, groups_of, with_focal

FEWEST_PHOTOS = 3

_SAME_PX, _FEWEST_SAME = 0.1, 4  # of the targets in two photographs: median distance, and how many
_SHARE_SAME = 0.8  # of the targets of either


def photos_by_camera(given: SurveySet, seen: list[Seen]) -> tuple[list[Group], dict[int, str]]:
    """Return the cameras with the photographs that take part, and why others do not, by number.

    Raises
    ------
    InputError, MeasurementError
        Where no focal length is told, or too few are left.
    """
    reasons: dict[int, str] = {}
    for number, (photo, found) in enumerate(zip(given.photos, seen, strict=True)):
        if photo in given.left_out:
            reasons[number] = "survey.yaml says so (leave_out)"
        elif found.problem is not None:
            reasons[number] = found.problem
    groups = groups_of(given, seen, [n for n in range(len(seen)) if n not in reasons])
    for group in groups:
        for number in group.photos:
            if seen[number].size_px != group.size_px:
                reasons[number] = _other_size(seen[number].size_px, group.size_px)
            elif not seen[number].targets:
                reasons[number] = f"no coded target of {given.target_family} was read in it"
    reasons |= _copies(given, seen, [n for n in range(len(seen)) if n not in reasons])
    groups = [left for group in groups if (left := _without(group, reasons)).photos]
    groups.sort(key=lambda group: -len(group.photos))
    for group in groups[1:]:
        if len(group.photos) < FEWEST_OF_CAMERA:
            reasons |= _too_few(group, groups[0])
    groups = [left for group in groups if (left := _without(group, reasons)).photos]
    count = len(seen) - len(reasons)
    if count < FEWEST_PHOTOS:
        told = "; ".join(f"{given.photos[n].name}: {why}" for n, why in list(reasons.items())[:5])
        raise MeasurementError(
            f"Expected {FEWEST_PHOTOS} photographs or more with coded targets, got {count}. {told}."
        )
    if groups[0].focal_px is None:
        first = groups[0]
        told_px = focal_length_px(tuple(given.photos[n] for n in first.photos), first.size_px)
        groups[0] = replace(first, focal_px=told_px)
    return with_focal(groups), reasons


def _without(group: Group, reasons: dict[int, str]) -> Group:
    return replace(group, photos=tuple(n for n in group.photos if n not in reasons))


def _too_few(group: Group, first: Group) -> dict[int, str]:
    """Return why the photographs of a camera that they cannot calibrate are left out."""
    if group.size_px != first.size_px:
        return dict.fromkeys(group.photos, _other_size(group.size_px, first.size_px))
    why = (
        f"it was taken with another camera, lens or focal length ({group.name}; most with"
        f" {first.name}), and {len(group.photos)} cannot calibrate it: take {FEWEST_OF_CAMERA} with"
        " it, or none"
    )
    return dict.fromkeys(group.photos, why)


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
