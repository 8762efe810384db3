"""survey.yaml: photographs taken by hand, their camera, targets and scale bars."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".tif", ".tiff", ".png")
_KEYS = (
    "camera", "photos", "leave_out", "target_family", "coded_dot_diameter_mm",
    "plain_dot_diameter_mm", "scale_bars", "check_bars", "datum",
)  # fmt: skip
_CAMERA_KEYS = ("name", "width_px", "height_px", "pixel_size_mm", "focal_length_mm")
_BAR_KEYS = (
    "ends", "length_mm", "sigma_mm", "temperature_C", "calibrated_at_C", "expansion_per_K",
    "temperature_sigma_K",
)  # fmt: skip


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
    """What a survey.yaml says; paths are complete. None: to be taken from the photographs."""

    camera_name: str | None
    size_px: tuple[int, int] | None
    focal_length_px: float | None
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
    root.refuse_unknown(*_KEYS)
    name, size, focal = _camera(root)
    photos, left_out = _photos(root, file.parent)
    return SurveySet(
        camera_name=name,
        size_px=size,
        focal_length_px=focal,
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
    camera = root.section("camera")
    camera.refuse_unknown(*_CAMERA_KEYS)
    name = camera.text("name") if "name" in camera else None
    size = None
    if "width_px" in camera or "height_px" in camera:
        size = (camera.integer("width_px", minimum=1), camera.integer("height_px", minimum=1))
    focal = None
    if "focal_length_mm" in camera or "pixel_size_mm" in camera:
        pixel = camera.number("pixel_size_mm", above=0.0)
        focal = camera.number("focal_length_mm", above=0.0) / pixel
    return name, size, focal


def _optional(root: YamlSection, key: str) -> float | None:
    return root.number(key, above=0.0) if key in root else None


def _photos(root: YamlSection, folder: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the photographs, and those among them that are to be left out."""
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
            raise InputError(f"{root.where}: {key}: found nothing that is called '{pattern}'.")
        found += [match for match in matches if match not in found]
    return found


def _bars(root: YamlSection, key: str) -> tuple[DeclaredBar, ...]:
    if key not in root:
        return ()
    given = root.get(key)
    if not isinstance(given, list):
        raise InputError(f"{root.where}: expected a list for '{key}'.")
    return tuple(
        _bar(YamlSection(entry, f"{root.where}: {key} {number}"))
        for number, entry in enumerate(given, start=1)
    )


def _bar(bar: YamlSection) -> DeclaredBar:
    bar.refuse_unknown(*_BAR_KEYS)
    first, second = (whole_number(e, f"{bar.where}: ends") for e in bar.numbers("ends", 2))
    if first == second:
        raise InputError(f"{bar.where}: expected two different ends, got {first} twice.")
    length, sigma = bar.number("length_mm", above=0.0), bar.number("sigma_mm", above=0.0)
    if "temperature_C" in bar:
        at = bar.number("calibrated_at_C") if "calibrated_at_C" in bar else 20.0
        expansion = bar.number("expansion_per_K")
        spread = 0.0
        if "temperature_sigma_K" in bar:
            spread = bar.number("temperature_sigma_K") * expansion * length
        length *= 1.0 + expansion * (bar.number("temperature_C") - at)
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
    datum.refuse_unknown("three_targets", "nominal")
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
