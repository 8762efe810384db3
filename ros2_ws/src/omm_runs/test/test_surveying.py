"""Photographs become coordinates: the rendered casting against its truth; bad sets in words."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from omm_core.errors import InputError, MeasurementError
from omm_core.imaging.photographs import read_grey
from omm_runs.photographs import focal_length_px
from omm_runs.survey_result import measured_bars, write_points
from omm_runs.surveying import survey

SET = Path(__file__).parents[4] / ".." / "shared" / "data" / "survey" / "casting"
needs_set = pytest.mark.skipif(not SET.is_dir(), reason="the data beside the project is missing")


@pytest.fixture(scope="module")
def casting():
    return survey(SET)


@pytest.fixture(scope="module")
def truth():
    return json.loads((SET / "truth.json").read_text())


def aligned(casting, truth):
    """Measured points in the truth's frame, (name, xyz), by the coded targets."""
    true = {p["id"]: np.array(p["xyz_mm"]) for p in truth["points"] if p["id"] is not None}
    coded = [p for p in casting.json["points"] if p["coded"]]
    there = np.array([p["xyz_mm"] for p in coded])
    wanted = np.array([true[p["id"]] for p in coded])
    turn, _ = Rotation.align_vectors(wanted - wanted.mean(0), there - there.mean(0))
    return [
        (p, turn.apply(np.array(p["xyz_mm"]) - there.mean(0)) + wanted.mean(0))
        for p in casting.json["points"]
    ], true


@needs_set
def test_all_coded_targets_of_the_casting_are_right(casting, truth):
    points, true = aligned(casting, truth)
    errors = np.array([xyz - true[p["id"]] for p, xyz in points if p["coded"]])
    assert len(errors) == 41
    assert (np.sqrt(np.mean(errors**2, axis=0)) < 0.03).all()
    bar = casting.json["check_bars"][0]
    assert bar["measured_mm"] == pytest.approx(bar["length_mm"], abs=0.05)


@needs_set
def test_plain_targets_are_found_and_none_that_is_not_there(casting, truth):
    points, _ = aligned(casting, truth)
    there = np.array([p["xyz_mm"] for p in truth["points"] if p["id"] is None])
    plain = np.array([xyz for p, xyz in points if not p["coded"]])
    apart = np.linalg.norm(plain[:, None] - there[None], axis=2)
    assert len(set(apart.argmin(axis=1).tolist())) == len(plain) >= 74
    errors = plain - there[apart.argmin(axis=1)]
    assert np.abs(errors).max() < 0.2
    assert (np.sqrt(np.mean(errors**2, axis=0)) < 0.05).all()


@needs_set
def test_normals_point_out_of_the_faces(casting, truth):
    true = {p["id"]: np.array(p["normal"]) for p in truth["points"] if p["id"] is not None}
    coded = [p for p in casting.json["points"] if p["coded"] and "normal" in p]
    turn, _ = Rotation.align_vectors(
        np.array([true[p["id"]] for p in coded]), np.array([p["normal"] for p in coded])
    )
    for p in coded:
        assert turn.apply(p["normal"]) @ true[p["id"]] > np.cos(np.radians(5.0))


@needs_set
def test_a_check_bar_that_is_off_is_told_with_its_sigmas(casting):
    good = casting.given.check_bars[0]
    for off_mm, told in ((0.0, False), (0.2, True), (-0.2, True)):
        findings: list[str] = []
        bar = replace(good, length_mm=good.length_mm + off_mm)
        (entry,) = measured_bars(casting.network, (bar,), "check bar", findings)
        assert entry["measured_mm"] == casting.json["check_bars"][0]["measured_mm"]
        assert bool(findings) == told
        if told:
            sigma = np.hypot(entry["sigma_mm"], bar.sigma_mm)
            by = abs(entry["measured_mm"] - bar.length_mm) / sigma
            assert f"{by:.1f} sigma" in findings[0]


@needs_set
def test_points_are_written_with_the_covariance_beside_them(casting, tmp_path):
    write_points(tmp_path / "points.json", casting)
    written = json.loads((tmp_path / "points.json").read_text())
    full = np.load(tmp_path / written["full_covariance"]["file"])
    assert full.shape == (3 * len(written["points"]),) * 2
    assert full[3:6, 3:6] == pytest.approx(np.array(written["points"][1]["covariance_mm2"]))
    assert written["full_covariance"]["order"] == [p["name"] for p in written["points"]]


def test_a_folder_without_survey_yaml_is_told_what_to_write(tmp_path):
    Image.new("L", (40, 30)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"target_family: aicon12(.|\n)*scale_bars"):
        survey(tmp_path)
    with pytest.raises(InputError, match="found neither"):
        survey(tmp_path / "..")


def test_photographs_of_nothing_end_in_words(tmp_path):
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((80, 120), 40 * i, dtype=np.uint8))
    (tmp_path / "survey.yaml").write_text(
        "photos: '*.png'\ntarget_family: aicon12\n"
        "camera: {pixel_size_mm: 0.01, focal_length_mm: 20}\n"
        "scale_bars: [{ends: [1, 2], length_mm: 100, sigma_mm: 0.01}]\n"
    )
    with pytest.raises(MeasurementError, match="no coded target"):
        survey(tmp_path)


def test_photographs_that_cannot_be_read_end_in_words(tmp_path):
    for i in range(3):
        (tmp_path / f"{i}.jpg").write_bytes(b"\xff\xd8 no picture")
    (tmp_path / "survey.yaml").write_text(
        "photos: '*.jpg'\ntarget_family: aicon12\n"
        "scale_bars: [{ends: [1, 2], length_mm: 100, sigma_mm: 0.01}]\n"
    )
    with pytest.raises(MeasurementError, match=r"0\.jpg: the file is cut off; 1\.jpg"):
        survey(tmp_path)


def test_an_orientation_tag_turns_nothing_and_exif_tells_the_focal_length(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees
    inner = exif.get_ifd(0x8769)
    inner[37386], inner[41486], inner[41488], inner[40962] = 24.0, 1000.0, 3, 240
    pixels = np.zeros((60, 120), dtype=np.uint8)
    pixels[:, 100:] = 200
    Image.fromarray(pixels).save(tmp_path / "a.jpg", exif=exif, quality=95)
    read = read_grey(tmp_path / "a.jpg")
    assert read.shape == (60, 120)
    assert read[30, 110] > 150 > 50 > read[30, 10]
    # 100 pixels a mm, and the picture was made half as wide.
    assert focal_length_px((tmp_path / "a.jpg",), (120, 60)) == pytest.approx(1200.0)


def test_colour_is_read_as_grey(tmp_path):
    colour = np.zeros((20, 30, 3), dtype=np.uint8)
    colour[5:10] = (255, 255, 255)
    for name in ("a.png", "a.tif", "a.jpg"):
        cv2.imwrite(str(tmp_path / name), colour)
        assert read_grey(tmp_path / name).shape == (20, 30)
