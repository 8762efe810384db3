"""One camera and each picture once: photographs that break this are named and left out."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from omm_core.errors import MeasurementError
from omm_core.files.survey import load_survey
from omm_runs.photographs import Seen
from omm_runs.survey_photos import doubled_numbers, photos_left_out

SIZE = (60, 40)


def exif(model, number, lens):
    found = Image.Exif()
    found[272] = model
    inner = found.get_ifd(0x8769)
    inner[42033], inner[42036] = number, lens
    return found


def folder_of(folder, cameras):
    """Write a photograph for each camera (None: without EXIF)."""
    for i, camera in enumerate(cameras):
        Image.new("L", SIZE).save(
            folder / f"p{i}.jpg", **({"exif": exif(*camera)} if camera else {})
        )
    (folder / "survey.yaml").write_text("photos: 'p*.jpg'\ntarget_family: aicon12\n")
    return load_survey(folder)


def seen(shift_px, size=SIZE):
    rng = np.random.default_rng(5)
    targets = tuple(
        SimpleNamespace(id=n, center_px=rng.uniform(0, 40, 2) + shift_px) for n in range(1, 7)
    )
    return Seen(size_px=size, targets=targets)


def test_photographs_of_another_body_or_lens_are_named_and_untold_ones_are_not(tmp_path):
    mine, body, lens = ("D5600", "42", "24 mm"), ("D5600", "43", "24 mm"), ("D5600", "42", "35 mm")
    cameras = [mine, mine, mine, body, lens, None, ("D5600", "", "24 mm")]
    given = folder_of(tmp_path, cameras)
    reasons = photos_left_out(given, [seen(5.0 * i) for i in range(7)], SIZE)
    assert set(reasons) == {3, 4}
    assert "D5600, 43, 24 mm; most with D5600, 42, 24 mm" in reasons[3]
    assert "set of their own" in reasons[4]


def test_a_copy_counts_once_and_a_camera_that_moved_counts(tmp_path):
    given = folder_of(tmp_path, [None] * 5)
    reasons = photos_left_out(given, [seen(s) for s in (0.0, 3.0, 0.02, 3.0, 0.5)], SIZE)
    assert set(reasons) == {2, 3}
    assert "where p0.jpg does" in reasons[2]
    assert "where p1.jpg does" in reasons[3]
    with pytest.raises(MeasurementError, match=r"got 2.*p2\.jpg: it shows the targets where p0"):
        photos_left_out(given, [seen(s) for s in (0.0, 3.0, 0.02, 3.0, 0.0)], SIZE)


def test_turned_pixels_are_told_from_other_sizes(tmp_path):
    given = folder_of(tmp_path, [None] * 5)
    sizes = (SIZE, SIZE, SIZE, SIZE[::-1], (30, 20))
    reasons = photos_left_out(given, [seen(5.0 * i, s) for i, s in enumerate(sizes)], SIZE)
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
