"""Files from outside: bounded, never read otherwise than people read them, typing errors told."""

import contextlib
import json
import os
import resource
import time
from pathlib import Path

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.outside import read_bytes
from omm_core.files.part import load_part
from omm_core.files.points import load_points
from omm_core.files.strict_yaml import parse_yaml
from omm_core.files.survey import load_survey
from omm_core.files.yaml_input import read_yaml
from omm_core.imaging.calibration import load_calibration

CAMERA = """
camera: {name: c, width_px: 2592, height_px: 1944, pixel_size_mm: 0.0022}
model: brown_photogrammetric
intrinsics: {focal_length_mm: 6.189, principal_point_offset_px: [-8.732, 27.52],
  k1_px2: 2.997e-08, k2_px4: -1.937e-15, p1_px: -6.188e-08, p2_px: 3.408e-07}
taper_to_camera: {translation_mm: [-2.139, 0.301, -320.2], euler_xyz_rad: [3.1386, -0.009, 0.03]}
"""
BOMB = "a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 10)
)
REFUSED = {
    "aliases that stand for a thousand million": (BOMB + "part: *a9\n", "values"),
    "a mapping of aliases as a key": (BOMB + "? *a9\n: 1\n", "values"),
    "an alias within itself": ("part: &p [*p]\n", "itself"),
    "deep nesting in lists": ("part: " + "[" * 100_000, "deeply"),
    "deep nesting in mappings": ("part: " + "{a: " * 5_000, "deeply"),
    "a key twice": ("part: {name: a}\nname: 1\nname: 2\n", "lines 2 and 3"),
    "a number twice as a key": ("0x10: 1\n16: 2\n", "lines 1 and 2"),
    "an octal number": ("id: 042\n", "'042'"),
    "a number to the base 60": ("x: 1:30\n", "'1:30'"),
    "a fraction to the base 60": ("x: 190:20:30.15\n", "'190:20:30.15'"),
    "thousands of digits": ("x: " + "9" * 5000 + "\n", "cannot be read"),
    "an empty number": ("x: !!int ''\n", "cannot be read"),
    "an empty fraction": ("x: !!float ''\n", "cannot be read"),
    "no truth": ("x: !!bool maybe\n", "cannot be read"),
    "no time": ("x: !!timestamp soon\n", "cannot be read"),
    "month 13": ("x: 2026-13-01\n", "cannot be read"),
    "an object of Python": ("x: !!python/object/apply:os.system [true]\n", "not YAML"),
    "a control character": ("x: \x07\n", "not YAML"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_hostile_yaml_is_refused_in_one_short_message(kind: str, tmp_path: Path) -> None:
    text, named = REFUSED[kind]
    path = tmp_path / "part.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"part\.yaml") as caught:
        read_yaml(path, "part file")
    assert named in str(caught.value)
    assert len(str(caught.value)) < 2000


def test_aliases_that_stay_small_are_read() -> None:
    assert parse_yaml("a: &a [1, 2]\nb: *a\nc: {<<: &m {x: 1}, y: 2}\nd: {<<: *m, x: 3}", "") == {
        "a": [1, 2],
        "b": [1, 2],
        "c": {"x": 1, "y": 2},
        "d": {"x": 3},
    }


def test_ten_thousand_hostile_texts_end_in_a_value_or_a_message() -> None:
    random = np.random.default_rng(31)
    words = ["a", ": ", "- ", "\n", "  ", "[", "]", "{", "}", "&x ", "*x", "!!int ", "!!set ", "? "]
    words += ["|", ">", "'", '"', "#", "<<: ", "1e999", "-.inf", ".nan", "0o7", "~", "\t", "---\n"]
    words += ["%YAML 1.3\n", "\ufeff", "é", "\U0001f600", "!!binary ", "!!omap ", "!!pairs ", "..."]
    for _ in range(10_000):
        text = "".join(random.choice(words, size=random.integers(1, 14)))
        with contextlib.suppress(InputError):
            parse_yaml(text, "it")


def test_what_is_no_ordinary_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path / "fifo", Path("/dev/zero"), tmp_path):
        start = time.monotonic()
        with pytest.raises(InputError, match=r"not an ordinary file|folder"):
            load_part(path)
        assert time.monotonic() - start < 10.0  # a FIFO would wait for ever


def test_a_file_larger_than_its_kind_is_not_read_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "part.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="at most 67 MB"):
        load_part(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300 << 10


@pytest.mark.parametrize("name", ["a\0b.yaml", "a" * 5000, "\udcff.yaml"])
def test_names_that_no_file_can_have_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        read_bytes(name, "part file")


@pytest.mark.parametrize(
    ("text", "key", "nearest"),
    [
        (CAMERA + "covarience: 1\n", "covarience", "covariance"),
        (CAMERA.replace("p2_px:", "k3_px2: 1.0, p2_px:"), "k3_px2", "k1_px2"),
        (CAMERA.replace("width_px:", "hight_px: 1, width_px:"), "hight_px", "height_px"),
    ],
)
def test_keys_that_nothing_reads_are_told_with_the_nearest_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, key: str, nearest: str
) -> None:
    (tmp_path / "c.yaml").write_text(text)
    load_calibration(tmp_path / "c.yaml")
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith("omm: warning:")
    assert f"'{key}' is not known and not read (nearest known one: {nearest})" in told
    (tmp_path / "c.yaml").write_text(CAMERA)
    load_calibration(tmp_path / "c.yaml")
    assert capsys.readouterr().err == ""


def test_a_number_no_machine_holds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "part.yaml"
    for bad in ("id: 99999999999999999999", "id: 1e5", "id: true"):
        path.write_text(
            "part: {name: p}\ntarget_family: aicon12\n"
            f"targets: [{{{bad}, xyz_mm: [0, 0, 0], dot_diameter_mm: 8}}]\n"
        )
        with pytest.raises(InputError, match="whole number"):
            load_part(path)
    path.write_text(
        "part: {name: p}\ntarget_family: aicon12\n"
        f"targets: [{{id: 1, xyz_mm: [{'9' * 400}, 0, 0], dot_diameter_mm: 8}}]\n"
    )
    with pytest.raises(InputError, match="finite"):
        load_part(path)


def test_a_name_that_yaml_reads_as_truth_is_asked_for_in_quotes(tmp_path: Path) -> None:
    path = tmp_path / "part.yaml"
    path.write_text("part: {name: no}\ntarget_family: aicon12\ntargets: [{id: 1}]\n")
    with pytest.raises(InputError, match="quotes"):
        read_yaml(path, "part file").section("part").text("name")


POINT = {"name": "1", "coded": True, "id": 1, "xyz_mm": [0, 0, 0]}
JSON_REFUSED = {
    "no JSON": "{",
    "a list": "[]",
    "deep nesting": "[" * 100_000,
    "a key twice": '{"points": [], "points": []}',
    "no number": '{"points": NaN}',
    "thousands of digits": '{"points": ' + "9" * 5000 + "}",
    "points that are words": '{"points": ["a"], "target_family": "a", "coded_dot_diameter_mm": 1}',
    "points that are a number": '{"points": 1, "target_family": "a", "coded_dot_diameter_mm": 1}',
}


@pytest.mark.parametrize("kind", JSON_REFUSED)
def test_hostile_points_are_refused(kind: str, tmp_path: Path) -> None:
    (tmp_path / "points.json").write_text(JSON_REFUSED[kind])
    with pytest.raises(InputError, match=r"points\.json"):
        load_points(tmp_path / "points.json")


@pytest.mark.parametrize("key", ["id", "xyz_mm", "normal", "covariance_mm2", "name"])
@pytest.mark.parametrize(
    "value", [1e999, "x", [], {}, [0, 0, 0], [[1]], None, 10**30, -1, [10**400, 0, 0], True]
)
def test_points_with_any_value_anywhere_are_read_or_refused(
    key: str, value: object, tmp_path: Path
) -> None:
    text = json.dumps(
        {"target_family": "aicon12", "coded_dot_diameter_mm": 8, "points": [POINT | {key: value}]}
    )
    (tmp_path / "points.json").write_text(text.replace("Infinity", "1e999"))
    try:
        points = load_points(tmp_path / "points.json")
    except InputError:
        return
    assert np.isfinite(points.points[0].xyz_mm).all()
    normal = points.points[0].normal
    assert normal is None or abs(np.linalg.norm(normal) - 1.0) < 1e-9


def test_a_pattern_of_photographs_that_is_none_is_refused(tmp_path: Path) -> None:
    text = "camera: {width_px: 9, height_px: 9, pixel_size_mm: 1, focal_length_mm: 1}\n"
    for pattern in ("''", "'**a'", "'/etc/*'", "'a\\0b'", '"a\\0b"', "[1]"):
        (tmp_path / "survey.yaml").write_text(f"{text}target_family: aicon12\nphotos: {pattern}\n")
        with pytest.raises(InputError, match="photos"):
            load_survey(tmp_path)


def test_json_of_a_fifo_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(InputError, match="ordinary"):
        read_json(tmp_path / "fifo", "points file")
