"""Photographs by camera, each picture once: those that break this are named and left out."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from omm_core.errors import InputError, MeasurementError
from omm_core.files.survey import load_survey
from omm_runs.photographs import Seen
from omm_runs.survey_cameras import assumed_words, shifts_px, zoom_advice
from omm_runs.survey_photos import doubled_numbers, photos_by_camera

SIZE = (60, 40)


def exif(model, number, lens, focal=24.0):
    found = Image.Exif()
    found[272] = model
    inner = found.get_ifd(0x8769)
    inner[42033], inner[42036], inner[37386] = number, lens, focal
    inner[41486], inner[41488], inner[40962] = 100.0, 4, SIZE[0]  # 100 pixels a mm
    return found


def folder_of(folder, cameras):
    """Write a photograph for each camera (None: without EXIF)."""
    for i, camera in enumerate(cameras):
        Image.new("L", SIZE).save(
            folder / f"p{i:02d}.jpg", **({"exif": exif(*camera)} if camera else {})
        )
    (folder / "survey.yaml").write_text(
        "photos: 'p*.jpg'\ntarget_family: aicon12\n"
        f"camera: {{pixel_size_mm: 0.01, focal_length_mm: 24, width_px: {SIZE[0]}, height_px: 40}}"
    )
    return load_survey(folder)


def reasons_of(given, shown):
    return photos_by_camera(given, shown)[1]


def seen(shift_px, size=SIZE):
    rng = np.random.default_rng(5)
    targets = tuple(
        SimpleNamespace(id=n, center_px=rng.uniform(0, 40, 2) + shift_px) for n in range(1, 7)
    )
    return Seen(size_px=size, targets=targets)


MINE, BODY, LENS = ("D5600", "42", "24 mm"), ("D5600", "43", "24 mm"), ("D5600", "42", "35 mm")


def test_each_body_and_lens_and_focal_length_is_a_camera(tmp_path):
    zoomed = (*MINE, 35.0)
    cameras = [*[MINE] * 6, *[BODY] * 5, *[zoomed] * 4, None, ("D5600", "", "24 mm")]
    given = folder_of(tmp_path, cameras)
    groups, reasons = photos_by_camera(given, [seen(5.0 * i) for i in range(17)])
    assert not reasons
    assert [group.photos for group in groups] == [
        (*range(6), 15, 16), (6, 7, 8, 9, 10), (11, 12, 13, 14)
    ]  # fmt: skip
    assert [group.name for group in groups] == [
        "D5600, 42, 24 mm, 24 mm", "D5600, 43, 24 mm, 24 mm", "D5600, 42, 24 mm, 35 mm"
    ]  # fmt: skip
    # The declared one; its body zoomed by as much as EXIF tells; another by EXIF alone.
    assert [group.focal_px for group in groups] == pytest.approx([2400.0, 2400.0, 3500.0])


def test_a_camera_that_tells_no_focal_length_begins_with_the_view_of_the_first(tmp_path):
    for i in range(9):
        told = Image.Exif()
        told[50708] = "D5600" if i < 5 else "D3200"
        Image.new("L", SIZE).save(tmp_path / f"p{i}.tif", exif=told)
    (tmp_path / "survey.yaml").write_text(
        "photos: 'p*.tif'\ntarget_family: aicon12\n"
        "camera: {pixel_size_mm: 0.01, focal_length_mm: 24}\n"
    )
    groups, reasons = photos_by_camera(load_survey(tmp_path), [seen(5.0 * i) for i in range(9)])
    assert not reasons
    assert [(g.name, g.focal_px, g.assumed) for g in groups] == [
        ("D5600", 2400.0, False), ("D3200", 2400.0, True)
    ]  # fmt: skip
    (told,) = assumed_words(groups)
    assert "focal length of D3200: it began at 2400 px" in told


def test_too_few_photographs_of_a_camera_are_named_and_left_out(tmp_path):
    cameras = [*[MINE] * 3, BODY, LENS, None, ("D5600", "", "24 mm")]
    given = folder_of(tmp_path, cameras)
    groups, reasons = photos_by_camera(given, [seen(5.0 * i) for i in range(7)])
    assert set(reasons) == {3, 4}
    assert [group.photos for group in groups] == [(0, 1, 2, 5, 6)]
    assert "D5600, 43, 24 mm, 24 mm; most with D5600, 42, 24 mm, 24 mm" in reasons[3]
    assert "1 cannot calibrate it: take 4 with it, or none" in reasons[4]


def test_cameras_that_survey_yaml_tells_are_believed(tmp_path):
    for name, size in (("a", (60, 40)), ("b", (90, 50))):
        for i in range(5):
            Image.new("L", size).save(tmp_path / f"{name}{i}.png")
    (tmp_path / "survey.yaml").write_text(
        "target_family: aicon12\ncameras:\n"
        "- {name: wide, photos: 'a*.png', pixel_size_mm: 0.01, focal_length_mm: 24}\n"
        "- {photos: [b0.png, 'b*.png'], pixel_size_mm: 0.005, focal_length_mm: 50}\n"
    )
    shown = [seen(5.0 * i, (60, 40) if i < 5 else (90, 50)) for i in range(10)]
    groups, reasons = photos_by_camera(load_survey(tmp_path), shown)
    assert not reasons
    assert [(g.name, g.size_px, g.focal_px) for g in groups] == [
        ("wide", (60, 40), 2400.0), ("camera 2", (90, 50), 10000.0)
    ]  # fmt: skip
    # Pixels of the larger are counted from where both have the same middle.
    assert shifts_px(groups)[7] == pytest.approx([-15.0, -5.0])


def test_a_copy_counts_once_and_a_camera_that_moved_counts(tmp_path):
    given = folder_of(tmp_path, [None] * 5)
    reasons = reasons_of(given, [seen(s) for s in (0.0, 3.0, 0.02, 3.0, 0.5)])
    assert set(reasons) == {2, 3}
    assert "where p00.jpg does" in reasons[2]
    assert "where p01.jpg does" in reasons[3]
    with pytest.raises(MeasurementError, match=r"got 2.*p02\.jpg: it shows the targets where p00"):
        photos_by_camera(given, [seen(s) for s in (0.0, 3.0, 0.02, 3.0, 0.0)])


def test_turned_pixels_are_told_from_other_sizes(tmp_path):
    given = folder_of(tmp_path, [None] * 5)
    sizes = (SIZE, SIZE, SIZE, SIZE[::-1], (30, 20))
    reasons = reasons_of(given, [seen(5.0 * i, s) for i, s in enumerate(sizes)])
    assert "turned its pixels" in reasons[3]
    assert "30 x 20 pixels, the camera's others 60 x 40: it was cut" in reasons[4]


def test_a_number_that_two_photographs_show_twice_stands_on_two_targets():
    shown = {"a": (7, 9), "b": (), "c": (7,)}
    doubled, words = doubled_numbers(
        {name: Seen(size_px=SIZE, twice=twice) for name, twice in shown.items()}
    )
    assert doubled == {7}
    assert words[0].startswith("Target 7 is left out: 2 photographs (a, c ...)")
    assert words[1].startswith("a: target 9 is read twice in it")


def test_cameras_that_cannot_be_meant_are_refused(tmp_path):
    for i in range(3):
        Image.new("L", SIZE).save(tmp_path / f"a{i}.png")
    for text, words in (
        ("cameras: [{photos: 'a*.png'}]\nphotos: 'a*.png'", "either 'cameras'"),
        ("cameras: [{photos: 'a*.png'}, {photos: [a1.png]}]", r"a1\.png is another camera's"),
        ("cameras: [{name: mine}]", "'photos' is missing"),
        ("cameras: {photos: 'a*.png'}", "expected a list"),
        ("cameras: [{photos: 'a*.png', focal_length_mm: 24}]", "pixel_size_mm"),
    ):
        (tmp_path / "survey.yaml").write_text(f"target_family: aicon12\n{text}\n")
        with pytest.raises(InputError, match=words):
            load_survey(tmp_path)


def test_photographs_with_another_zoom_can_be_a_camera_of_their_own_from_four_on():
    names = [f"p{i}.jpg" for i in range(4)]
    assert zoom_advice(names[:3]) == []
    (words,) = zoom_advice(names)
    assert words.startswith("4 photographs")
    assert "cameras in survey.yaml" in words
