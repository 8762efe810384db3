"""A survey from its folder: look at all photographs, adjust, say what came out."""

from __future__ import annotations

from pathlib import Path

from omm_core.errors import InputError, MeasurementError
from omm_core.files.survey import SurveySet, load_survey
from omm_core.survey import Bar, solve_network
from omm_core.survey.sighting import CODED, PLAIN, sighting_of_target
from omm_core.targets import TargetFamily
from omm_runs.photographs import look_at_all
from omm_runs.survey_cameras import assumed_words, cameras_of, shifts_px
from omm_runs.survey_photos import FEWEST_PHOTOS, doubled_numbers, photos_by_camera
from omm_runs.survey_result import SurveyResult, as_json, delivered


def survey(path: Path) -> SurveyResult:
    """Measure the targets of a set.

    Raises
    ------
    InputError, MeasurementError
    """
    given = load_survey(path)
    TargetFamily.by_name(given.target_family)
    if len(given.photos) - len(given.left_out) < FEWEST_PHOTOS:
        raise MeasurementError(
            f"Expected {FEWEST_PHOTOS} photographs or more, got"
            f" {len(given.photos) - len(given.left_out)}: three rays make a point."
        )
    if not given.scale_bars:
        raise InputError(
            f"{path}: expected scale_bars (ends, length_mm, sigma_mm) in survey.yaml: photographs"
            " alone do not tell how large things are."
        )
    seen = look_at_all(given.photos, given.target_family)
    groups, left_out = photos_by_camera(given, seen)
    cameras, shifts = cameras_of(groups), shifts_px(groups)
    taken = {n: s.moved(shifts[n]) for n, s in enumerate(seen) if n not in left_out}
    doubled, words = doubled_numbers({given.photos[n].name: s for n, s in taken.items()})
    network = solve_network(
        [
            sighting_of_target(n, target)
            for n, s in taken.items()
            for target in s.targets
            if target.id not in doubled
        ],
        [Bar(ends=b.ends, length_mm=b.length_mm, sigma_mm=b.sigma_mm) for b in given.scale_bars],
        cameras,
        groups[0].size_px,
        {n: s.dots for n, s in taken.items()},
        _diameters(given),
    )
    out = delivered(network, given.datum)
    json = as_json(given, network, out, left_out, groups, [*words, *assumed_words(groups)])
    return SurveyResult(given=given, network=network, delivered=out, json=json)


def _diameters(given: SurveySet) -> dict[str, float]:
    declared = ((CODED, given.coded_dot_diameter_mm), (PLAIN, given.plain_dot_diameter_mm))
    return {kind: diameter for kind, diameter in declared if diameter is not None}
