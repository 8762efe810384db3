"""survey.yaml: photographs taken by hand, their camera, targets and scale bars."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError, warn
from omm_core.files.declared import integer, number, read_section, text, values
from omm_core.files.yaml_input import YamlSection, read_yaml

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".tif", ".tiff", ".png")
_KEYS = (
    "camera", "cameras", "photos", "leave_out", "target_family", "coded_dot_diameter_mm",
    "plain_dot_diameter_mm", "scale_bars", "check_bars", "datum",
)  # fmt: skip
_OF_TEMPERATURE = ("expansion_per_K", "temperature_sigma_K", "calibrated_at_C")
_LARGEST_EXPANSION_PER_K = 1e-3  # rubber: 0.25e-3


@dataclass(frozen=True, kw_only=True)
class _Camera:
    name: Annotated[str | None, text()] = None
    width_px: Annotated[int | None, integer(minimum=1)] = None
    height_px: Annotated[int | None, integer(minimum=1)] = None
    pixel_size_mm: Annotated[float | None, number(above=0.0)] = None
    focal_length_mm: Annotated[float | None, number(above=0.0)] = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DeclaredCamera:
    """A camera, and the photographs that were taken with it; None: see the photographs."""

    name: str | None
    size_px: tuple[int, int] | None
    focal_length_px: float | None
    photos: tuple[Path, ...]


@dataclass(frozen=True, kw_only=True)
class _Bar:
    ends: Annotated[tuple[float, ...], values(2)]
    length_mm: Annotated[float, number(above=0.0)]
    sigma_mm: Annotated[float, number(above=0.0)]
    temperature_C: Annotated[float | None, number()] = None
    temperature_sigma_K: Annotated[float, number(least=0.0)] = 0.0
    calibrated_at_C: Annotated[float, number()] = 20.0
    expansion_per_K: Annotated[float | None, number()] = None


@dataclass(frozen=True, kw_only=True)
class DeclaredBar:
    """A bar between two coded targets, as long as it is at its temperature."""

    ends: tuple[int, int]
    length_mm: float
    sigma_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class DeclaredDatum:
    """In which frame coordinates are wanted.

    Attributes
    ----------
    kind : ``free``, ``three_targets`` or ``nominal``.
    targets : of ``three_targets``: origin, on the x axis, in the x-y plane (y > 0).
    nominal_mm : of ``nominal``: coordinates (3,) by number of the coded target.
    """

    kind: str = "free"
    targets: tuple[int, ...] = ()
    nominal_mm: dict[int, NDArray[np.float64]] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveySet:
    """What a survey.yaml says; paths are complete. None: to be taken from the photographs.

    Name, size and focal length are those of the camera, unless ``cameras`` tells of several.
    """

    camera_name: str | None
    size_px: tuple[int, int] | None
    focal_length_px: float | None
    cameras: tuple[DeclaredCamera, ...]
    photos: tuple[Path, ...]
    left_out: tuple[Path, ...]
    target_family: str
    coded_dot_diameter_mm: float | None
    plain_dot_diameter_mm: float | None
    scale_bars: tuple[DeclaredBar, ...]
    check_bars: tuple[DeclaredBar, ...]
    datum: DeclaredDatum


def load_survey(path: Path) -> SurveySet:
    """Read a survey.yaml, or the one in a folder.

    Raises
    ------
    InputError
        Where it is missing or malformed, or names no photographs.
    """
    file = path / "survey.yaml" if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        raise InputError(_how_to_write(path))
    root = read_yaml(file, "survey file")
    root.check_keys(*_KEYS)
    name, size, focal = _camera(root)
    cameras = _cameras(root, file.parent)
    photos, left_out = _photos(root, file.parent, cameras)
    return SurveySet(
        camera_name=name,
        size_px=size,
        focal_length_px=focal,
        cameras=cameras,
        photos=photos,
        left_out=left_out,
        target_family=root.text("target_family"),
        coded_dot_diameter_mm=_optional(root, "coded_dot_diameter_mm"),
        plain_dot_diameter_mm=_optional(root, "plain_dot_diameter_mm"),
        scale_bars=_bars(root, "scale_bars"),
        check_bars=_bars(root, "check_bars"),
        datum=_datum(root),
    )


def photos_in(folder: Path) -> tuple[Path, ...]:
    """Return the photographs in a folder, by name."""
    return tuple(sorted(p for p in folder.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES))


def _how_to_write(folder: Path) -> str:
    count = len(photos_in(folder))
    if not count:
        return (
            f"Expected photographs ({', '.join(PHOTO_SUFFIXES)}) or a survey.yaml in {folder},"
            " found neither."
        )
    return (
        f"{folder} holds {count} photographs but no survey.yaml: which family of targets they show"
        " and how long the scale bars are is nowhere to be seen. Write survey.yaml beside them:\n"
        "  photos: '*" + photos_in(folder)[0].suffix + "'\n"
        "  target_family: aicon12        # or aicon14, metashape12, ...\n"
        "  scale_bars:\n"
        "  - {ends: [1, 2], length_mm: 1000.000, sigma_mm: 0.005}   # numbers of coded targets\n"
        "The camera is then taken from the photographs' EXIF."
    )


def _camera(root: YamlSection) -> tuple[str | None, tuple[int, int] | None, float | None]:
    """Return name, size and focal length in pixels, as far as they are given."""
    if "camera" not in root:
        return None, None, None
    return _camera_of(root.section("camera"))


def _camera_of(section: YamlSection) -> tuple[str | None, tuple[int, int] | None, float | None]:
    camera = read_section(_Camera, section)
    size = _both(section, "width_px", "height_px", camera)
    focal = _both(section, "focal_length_mm", "pixel_size_mm", camera)
    return (
        camera.name,
        None if size is None else (int(size[0]), int(size[1])),
        None if focal is None else focal[0] / focal[1],
    )


def _cameras(root: YamlSection, folder: Path) -> tuple[DeclaredCamera, ...]:
    """Return the cameras of ``cameras``, each with its photographs."""
    if "cameras" in root and ("camera" in root or "photos" in root):
        raise InputError(
            f"{root.where}: expected either 'cameras', each with its photos, or one 'camera' and"
            " 'photos', got both."
        )
    found = []
    taken: set[Path] = set()
    for section in root.sections("cameras"):
        photos = _matching(section, "photos", folder)
        twice = [photo.name for photo in photos if photo in taken]
        if twice:
            raise InputError(f"{section.where}: {twice[0]} is another camera's, too.")
        taken |= set(photos)
        bare = {key: value for key, value in section.values.items() if key != "photos"}
        name, size, focal = _camera_of(YamlSection(bare, section.where))
        found.append(
            DeclaredCamera(name=name, size_px=size, focal_length_px=focal, photos=tuple(photos))
        )
    return tuple(found)


def _both(
    section: YamlSection, first: str, second: str, camera: _Camera
) -> tuple[float, float] | None:
    """Return two values of which neither says anything without the other; None without both."""
    told = [getattr(camera, key) for key in (first, second)]
    if told == [None, None]:
        return None
    return section.number(first), section.number(second)  # tells which one is missing


def _optional(root: YamlSection, key: str) -> float | None:
    return root.number(key, above=0.0) if key in root else None


def _photos(
    root: YamlSection, folder: Path, cameras: tuple[DeclaredCamera, ...]
) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the photographs, and those among them that are to be left out."""
    found = [photo for camera in cameras for photo in camera.photos]
    if not cameras:
        found = _matching(root, "photos", folder)
    out = _matching(root, "leave_out", folder) if "leave_out" in root else []
    return tuple(found), tuple(photo for photo in out if photo in found)


def _matching(root: YamlSection, key: str, folder: Path) -> list[Path]:
    given = root.get(key)
    patterns = [given] if isinstance(given, str) else given
    if not isinstance(patterns, list) or not all(isinstance(p, str) and p for p in patterns):
        raise InputError(f"{root.where}: expected a pattern or a list of files for '{key}'.")
    found: list[Path] = []
    for pattern in patterns:
        if Path(pattern).is_absolute():
            raise InputError(f"{root.where}: {key}: expected names relative to this file.")
        try:
            matches = sorted(folder.glob(pattern))
        except (ValueError, OSError) as error:
            raise InputError(f"{root.where}: {key}: '{pattern}': {error}.") from None
        if not matches:
            near = [p.name for p in folder.glob("*") if fnmatch(p.name.lower(), pattern.lower())]
            hint = f" Capitals count: there is {min(near)}." if near else ""
            raise InputError(
                f"{root.where}: {key}: found nothing that is called '{pattern}'.{hint}"
            )
        found += [match for match in matches if match not in found]
    return found


def _bars(root: YamlSection, key: str) -> tuple[DeclaredBar, ...]:
    return tuple(_bar(section) for section in root.sections(key))


def _bar(section: YamlSection) -> DeclaredBar:
    bar = read_section(_Bar, section)
    first, second = (whole_number(e, f"{section.where}: ends") for e in bar.ends)
    if first == second:
        raise InputError(f"{section.where}: expected two different ends, got {first} twice.")
    length, sigma = bar.length_mm, bar.sigma_mm
    idle = [k for k in _OF_TEMPERATURE if k in section] if bar.temperature_C is None else []
    if idle:
        warn(f"{section.where}: {idle[0]} changes nothing without temperature_C.")
    if bar.temperature_C is not None:
        expansion = section.number("expansion_per_K")
        if abs(expansion) > _LARGEST_EXPANSION_PER_K:
            raise InputError(
                f"{section.where}: expected expansion_per_K as steel's, 11.5e-6, got {expansion:g}."
            )
        spread = bar.temperature_sigma_K * expansion * length
        length *= 1.0 + expansion * (bar.temperature_C - bar.calibrated_at_C)
        sigma = float(np.hypot(sigma, spread))
    return DeclaredBar(ends=(first, second), length_mm=length, sigma_mm=sigma)


def whole_number(value: Any, where: str) -> int:
    """Return a target's number; it must be whole and above 0."""
    if not 1 <= value <= 1e9 or float(value) != int(value):
        raise InputError(f"{where}: expected numbers of coded targets (1, 2, ...), got {value:g}.")
    return int(value)


def _datum(root: YamlSection) -> DeclaredDatum:
    if "datum" not in root or root.get("datum") == "free":
        return DeclaredDatum()
    datum = root.section("datum")
    datum.check_keys("three_targets", "nominal")
    if "three_targets" in datum and "nominal" in datum:
        raise InputError(f"{datum.where}: expected three_targets or nominal, got both.")
    if "three_targets" in datum:
        where = f"{datum.where}: three_targets"
        targets = tuple(whole_number(t, where) for t in datum.numbers("three_targets", 3))
        if len(set(targets)) < 3:
            raise InputError(f"{where}: expected three different targets, got {targets}.")
        return DeclaredDatum(kind="three_targets", targets=targets)
    nominal = datum.section("nominal")
    places = {}
    for key in nominal.values:
        if isinstance(key, bool) or not isinstance(key, int):
            raise InputError(f"{nominal.where}: expected numbers of coded targets, got {key!r}.")
        places[whole_number(key, nominal.where)] = nominal.numbers(key, 3)  # type: ignore[arg-type]
    if len(places) < 3:
        raise InputError(f"{nominal.where}: expected three targets or more, got {len(places)}.")
    return DeclaredDatum(kind="nominal", nominal_mm=places)
