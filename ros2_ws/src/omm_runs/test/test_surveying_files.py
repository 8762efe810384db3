"""Photographs as people store them: every kind of file serves, what cannot is named."""

import cv2
import numpy as np
import pytest
from drawn_photographs import HEIGHT, NUMBERS, WIDTH, bar_mm, photograph, targets_mm
from PIL import Image
from scipy.spatial.transform import Rotation

from omm_core.errors import InputError
from omm_runs.photographs import focal_length_px
from omm_runs.surveying import survey

DECLARED = "camera: {pixel_size_mm: 0.01, focal_length_mm: 10}\n"
BARS = "".join(
    f"- {{ends: [{a}, {b}], length_mm: {bar_mm(a, b):.5f}, sigma_mm: 0.005}}\n"
    for a, b in ((1, 4), (1, 13))
)


def exif(focal_length_mm):
    """Return EXIF of a camera with pixels of 0.01 mm, whose picture is to be turned."""
    found = Image.Exif()
    found[0x0112] = 6
    inner = found.get_ifd(0x8769)
    inner[37386], inner[41486], inner[41488], inner[40962] = focal_length_mm, 1000.0, 3, WIDTH
    return found


def set_of(folder, declared=""):
    """Write survey.yaml for all files in a folder."""
    (folder / "survey.yaml").write_text(
        f"photos: ['*.[pjt]*']\ntarget_family: aicon12\n{declared}scale_bars:\n{BARS}"
    )
    return folder


def errors_mm(found):
    """Return the coordinates' errors after a fit without scale, (N, 3)."""
    true = dict(zip(NUMBERS, targets_mm(), strict=True))
    there = np.array([p["xyz_mm"] for p in found.json["points"]])
    wanted = np.array([true[p["id"]] for p in found.json["points"]])
    there, wanted = there - there.mean(axis=0), wanted - wanted.mean(axis=0)
    turn, _ = Rotation.align_vectors(wanted, there)
    return turn.apply(there) - wanted


def write_mixed(folder):
    """Write eight photographs: TIFF and PNG of 16 bit, JPEG and PNG in colour."""
    for i in range(8):
        grey = photograph(i)
        if i % 4 == 0:
            Image.fromarray(257 * grey.astype(np.uint16)).save(folder / f"p{i}.tif")
        elif i % 4 == 1:
            cv2.imwrite(str(folder / f"p{i}.png"), 200 * grey.astype(np.uint16))
        elif i % 4 == 2:
            warm = np.stack([grey, 0.9 * grey, 0.8 * grey], axis=2).astype(np.uint8)
            Image.fromarray(warm).save(folder / f"p{i}.jpg", exif=exif(10.0), quality=95)
        else:
            Image.fromarray(np.stack([grey] * 3, axis=2)).save(folder / f"p{i}.png")


def test_every_kind_of_file_serves_and_bad_photographs_are_named(tmp_path):
    write_mixed(tmp_path)
    Image.fromarray(np.full((HEIGHT, WIDTH), 90, np.uint8)).save(tmp_path / "empty.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "p1.png").read_bytes()[:9000])
    (tmp_path / "text.jpg").write_text("no picture")
    small = Image.fromarray(photograph(1)).resize((400, 300), Image.Resampling.BOX)
    small.save(tmp_path / "small.jpg", exif=exif(25.0))
    Image.fromarray(photograph(2)).save(tmp_path / "zoomed.jpg", exif=exif(25.0))
    # What EXIF tells of photographs that do not take part stops nobody.
    found = survey(set_of(tmp_path, "leave_out: [zoomed.jpg]\n"))
    reasons = {p["file"]: p["reason"] for p in found.json["photos"] if not p["used"]}
    assert set(reasons) == {"cut.png", "empty.png", "small.jpg", "text.jpg", "zoomed.jpg"}
    assert "cut off" in reasons["cut.png"]
    assert "no coded target" in reasons["empty.png"]
    assert "400 x 300 pixels, the camera's others 800 x 600" in reasons["small.jpg"]
    assert "not an image" in reasons["text.jpg"]
    for name in reasons:
        assert any(words.startswith(f"{name} is left out") for words in found.json["findings"])
    assert len(found.json["points"]) == len(NUMBERS)
    assert (np.sqrt(np.mean(errors_mm(found) ** 2, axis=0)) < 0.005).all()
    assert found.json["camera"]["values"][0] == pytest.approx(1000.0, abs=0.3)


def test_three_photographs_measure_but_are_told_not_to_calibrate_the_lens(tmp_path):
    for i in range(3):
        Image.fromarray(photograph(i)).save(tmp_path / f"p{i}.png")
    found = survey(set_of(tmp_path, DECLARED))
    assert (np.sqrt(np.mean(errors_mm(found) ** 2, axis=0)) < 0.01).all()
    assert any("3 photographs do not calibrate the lens" in w for w in found.json["findings"])


def test_photographs_of_another_focal_length_are_named(tmp_path):
    for name, focal in (("a", 24.0), ("b", 24.0), ("c", 35.0), ("d", 24.1)):
        Image.new("L", (WIDTH, HEIGHT)).save(tmp_path / f"{name}.jpg", exif=exif(focal))
    photos = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"2400 to 3500 pixels.*differ: c\.jpg\.$"):
        focal_length_px(tuple(photos), (WIDTH, HEIGHT))
    told = focal_length_px((photos[0], photos[1], photos[3]), (WIDTH, HEIGHT))
    assert told == pytest.approx(2400.0)
