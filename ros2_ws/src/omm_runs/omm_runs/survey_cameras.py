"""Which photographs of a survey one camera took: as survey.yaml says, or as their EXIF tells.

A camera is a body with a lens at one focal length: each has an interior orientation of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.survey import SurveySet
from omm_core.survey.cameras import Cameras
from omm_runs.photographs import SAME_FOCAL, Seen, focal_length_px, focal_told, taken_with

FEWEST_OF_CAMERA = 4  # photographs that calibrate a camera

Array = NDArray[np.float64]
Told = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Group:
    """Photographs (by number) of one camera.

    ``focal_px`` is None where nothing tells it; ``assumed``: it is another camera's.
    """

    name: str
    size_px: tuple[int, int]
    focal_px: float | None
    photos: tuple[int, ...]
    assumed: bool = False


def groups_of(given: SurveySet, seen: list[Seen], numbers: list[int]) -> list[Group]:
    """Return the cameras of some photographs, the one with the most of them first."""
    if given.cameras:
        return _declared(given, seen, numbers)
    told = {n: (*taken_with(given.photos[n]), _rounded(given, n)) for n in numbers}
    sets = _alike(told)
    if given.size_px is not None:  # the declared camera before others
        sets.sort(key=lambda own: -sum(seen[n].size_px == given.size_px for n in own))
    groups = []
    for k, own in enumerate(sets):
        size = _usual_size(seen, own)
        if k == 0:
            size, focal = given.size_px or size, given.focal_length_px
        if k > 0 or focal is None:
            focal = _other_focal(given, seen, sets[0], own, size)
        name = (given.camera_name if k == 0 else None) or _name(told, own) or f"camera {k + 1}"
        groups.append(Group(name=name, size_px=size, focal_px=focal, photos=tuple(own)))
    return _named_apart(groups)


def cameras_of(groups: list[Group]) -> Cameras:
    """Return the cameras of groups that all know their focal length."""
    return Cameras(
        focal_px=tuple(float(g.focal_px or np.nan) for g in groups),
        names=tuple(g.name for g in groups),
        of={n: row for row, g in enumerate(groups) for n in g.photos},
    )


def with_focal(groups: list[Group]) -> list[Group]:
    """Return the cameras, each with a focal length: where none is told, the first one's angle."""
    first = groups[0]
    return [
        replace(
            group, assumed=True,
            focal_px=float(first.focal_px or np.nan) * max(group.size_px) / max(first.size_px),
        )
        if group.focal_px is None
        else group
        for group in groups
    ]  # fmt: skip


def assumed_words(groups: list[Group]) -> list[str]:
    """Tell of focal lengths that nothing told."""
    return [
        f"Nothing tells the focal length of {group.name}: it began at {group.focal_px:.0f} px, with"
        f" the field of view of {groups[0].name}. Give it under 'cameras' in survey.yaml."
        for group in groups
        if group.assumed
    ]


def shifts_px(groups: list[Group]) -> dict[int, Array]:
    """Return by how much each photograph's pixels are moved so that all share one middle."""
    first = np.array(groups[0].size_px)
    return {n: (first - g.size_px) / 2.0 for g in groups for n in g.photos}


def _declared(given: SurveySet, seen: list[Seen], numbers: list[int]) -> list[Group]:
    number_of = {given.photos[n]: n for n in numbers}
    groups = []
    for k, camera in enumerate(given.cameras, start=1):
        own = [number_of[photo] for photo in camera.photos if photo in number_of]
        if not own:
            continue
        size = camera.size_px or _usual_size(seen, own)
        focal = camera.focal_length_px or _exif_focal(given, seen, own, size)
        name = camera.name or f"camera {k}"
        groups.append(Group(name=name, size_px=size, focal_px=focal, photos=tuple(own)))
    return _named_apart(sorted(groups, key=lambda group: -len(group.photos)))


def _rounded(given: SurveySet, number: int) -> str:
    focal = focal_told(given.photos[number])
    return "" if focal is None else repr(focal)


def _alike(told: dict[int, Told]) -> list[list[int]]:
    """Return photographs whose cameras do not differ; those that tell less go with the most."""
    sets: list[tuple[Told, list[int]]] = []
    order = Counter(camera for camera in told.values() if any(camera))
    for camera, _ in order.most_common():
        if not any(_same(camera, other) for other, _ in sets):
            sets.append((camera, []))
    sets = sets or [((), [])]
    for n, camera in told.items():
        next(own for other, own in sets if _same(camera, other)).append(n)
    return sorted((own for _, own in sets if own), key=lambda own: -len(own))


def _same(one: Told, other: Told) -> bool:
    if any(a and b and a != b for a, b in zip(one[:-1], other[:-1], strict=False)):
        return False
    if not one or not other or not one[-1] or not other[-1]:
        return True
    focal = sorted((float(one[-1]), float(other[-1])))
    return focal[1] <= SAME_FOCAL * focal[0]


def _usual_size(seen: list[Seen], own: list[int]) -> tuple[int, int]:
    return Counter(seen[n].size_px for n in own).most_common(1)[0][0]


def _files(
    given: SurveySet, seen: list[Seen], own: list[int], size: tuple[int, int]
) -> tuple[Path, ...]:
    return tuple(given.photos[n] for n in own if seen[n].size_px == size)


def _other_focal(
    given: SurveySet, seen: list[Seen], first: list[int], own: list[int], size: tuple[int, int]
) -> float | None:
    """Return the focal length of a further camera, px: of the same model by the ratio told."""
    models = [taken_with(given.photos[group[0]])[0] for group in (first, own)]
    told = [focal_told(given.photos[group[0]]) for group in (first, own)]
    if given.focal_length_px and models[0] == models[1] and told[0] and told[1]:
        return given.focal_length_px * told[1] / told[0]
    return _exif_focal(given, seen, own, size)


def _exif_focal(
    given: SurveySet, seen: list[Seen], own: list[int], size: tuple[int, int]
) -> float | None:
    try:
        return focal_length_px(_files(given, seen, own, size), size)
    except InputError:
        return None


def _name(told: dict[int, Told], own: list[int]) -> str:
    *words, focal = max((told[n] for n in own), key=lambda camera: sum(map(bool, camera)))
    return ", ".join([word for word in words if word] + ([f"{float(focal):g} mm"] if focal else []))


def _named_apart(groups: list[Group]) -> list[Group]:
    """Give cameras of one name a number each."""
    count = Counter(group.name for group in groups)
    return [
        replace(group, name=f"{group.name} ({k})") if count[group.name] > 1 else group
        for k, group in enumerate(groups, start=1)
    ]


def zoom_advice(names: Sequence[str]) -> list[str]:
    """Return how photographs that were taken with another focal length can be used all the same."""
    if len(names) < FEWEST_OF_CAMERA:
        return []
    return [
        f"{len(names)} photographs have another focal length than the others. They can be used all"
        " the same: as a camera of their own, under cameras in survey.yaml, with another name and"
        " their focal length."
    ]
