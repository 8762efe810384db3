"""survey.yaml: photographs taken by hand, their camera, targets and scale bars."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from omm_core.errors import InputError
from omm_core.files.yaml_input import YamlSection, read_yaml

_KEYS = (
    "camera", "photos", "target_family", "coded_dot_diameter_mm", "plain_dot_diameter_mm",
    "scale_bars", "check_bars", "datum",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class DeclaredBar:
    """A bar between two coded targets."""

    ends: tuple[int, int]
    length_mm: float
    sigma_mm: float


@dataclass(frozen=True, kw_only=True)
class SurveySet:
    """What a survey.yaml says; paths are complete."""

    camera_name: str
    width_px: int
    height_px: int
    focal_length_px: float
    photos: tuple[Path, ...]
    target_family: str
    coded_dot_diameter_mm: float | None
    plain_dot_diameter_mm: float | None
    scale_bars: tuple[DeclaredBar, ...]
    check_bars: tuple[DeclaredBar, ...]


def load_survey(path: Path) -> SurveySet:
    """Read a survey.yaml, or the one in a folder.

    Raises
    ------
    InputError
        Where it is missing or malformed, or names no photographs.
    """
    file = path / "survey.yaml" if path.is_dir() else path
    root = read_yaml(file, "survey file")
    root.warn_unknown(*_KEYS)
    camera = root.section("camera")
    camera.warn_unknown("name", "width_px", "height_px", "pixel_size_mm", "focal_length_mm")
    pixel = camera.number("pixel_size_mm", above=0.0)
    return SurveySet(
        camera_name=camera.text("name") if "name" in camera else "camera",
        width_px=camera.integer("width_px", minimum=1),
        height_px=camera.integer("height_px", minimum=1),
        focal_length_px=camera.number("focal_length_mm", above=0.0) / pixel,
        photos=_photos(root, file.parent),
        target_family=root.text("target_family"),
        coded_dot_diameter_mm=_optional(root, "coded_dot_diameter_mm"),
        plain_dot_diameter_mm=_optional(root, "plain_dot_diameter_mm"),
        scale_bars=_bars(root, "scale_bars"),
        check_bars=_bars(root, "check_bars"),
    )


def _optional(root: YamlSection, key: str) -> float | None:
    return root.number(key, above=0.0) if key in root else None


def _photos(root: YamlSection, folder: Path) -> tuple[Path, ...]:
    given = root.get("photos")
    patterns = [given] if isinstance(given, str) else given
    if not isinstance(patterns, list) or not all(isinstance(p, str) for p in patterns):
        raise InputError(f"{root.where}: expected a pattern or a list of files for 'photos'.")
    found: list[Path] = []
    for pattern in patterns:
        if Path(pattern).is_absolute():
            raise InputError(f"{root.where}: photos: expected names relative to this file.")
        try:
            matches = sorted(folder.glob(pattern))
        except (ValueError, OSError, IndexError) as error:
            raise InputError(f"{root.where}: photos: {pattern!r}: {error}.") from None
        if not matches:
            raise InputError(f"{root.where}: photos: found nothing that is called '{pattern}'.")
        found += [match for match in matches if match not in found]
    return tuple(found)


def _bars(root: YamlSection, key: str) -> tuple[DeclaredBar, ...]:
    if key not in root:
        return ()
    given = root.get(key)
    if not isinstance(given, list):
        raise InputError(f"{root.where}: expected a list for '{key}'.")
    bars = []
    for number, entry in enumerate(given, start=1):
        bar = YamlSection(entry, f"{root.where}: {key} {number}")
        bar.warn_unknown("ends", "length_mm", "sigma_mm")
        first, second = bar.numbers("ends", 2)
        bars.append(
            DeclaredBar(
                ends=(int(first), int(second)),
                length_mm=bar.number("length_mm", above=0.0),
                sigma_mm=bar.number("sigma_mm", above=0.0),
            )
        )
    return tuple(bars)
