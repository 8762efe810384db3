"""A survey's document and scene hold what the result says, on any day the same."""

import json
import re

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_report.survey_pictures import write_pictures
from omm_report.survey_report import _length_rows, per_photo_figure, survey_document
from omm_report.survey_scene import survey_scene
from omm_report.survey_text import survey_text


def result() -> dict:
    rng = np.random.default_rng(1)
    points = [
        {
            "name": str(i) if i % 2 else f"P{i}", "coded": bool(i % 2), "id": i,
            "xyz_mm": rng.uniform(0, 500, 3).tolist(),
            "covariance_mm2": np.diag([1e-4, 4e-4, 9e-4]).tolist(), "images": 3 + i,
        }
        for i in range(1, 9)
    ]  # fmt: skip
    photo = {"used": True, "reason": None, "euler_xyz_rad": [0.1, 3.0, 0.0]}
    photos = [{"file": f"a{i}.jpg", "position_mm": [0.0, 0.0, 900.0 + i], **photo} for i in (1, 2)]
    photos.append(
        {"file": "b.jpg", "used": False, "reason": "<blurred>", "position_mm": None,
         "euler_xyz_rad": None}
    )  # fmt: skip
    bar = {"ends": [1, 3], "length_mm": 100.0, "measured_mm": 100.002, "sigma_mm": 0.004}
    length = {"ends": [1, 5], "length_mm": 300.0, "measured_mm": 300.01, "error_mm": 0.01,
              "sigma_mm": 0.004, "limit_mm": 0.056, "within": True}  # fmt: skip
    return {
        "converged": True, "sigma0": 1.1, "rms_px": 0.012, "degrees_of_freedom": 40,
        "camera": {"parameters": ["f"], "values": [3000.0], "covariance": [[0.01]]},
        "points": points, "photos": photos, "scale_bars": [bar], "check_bars": [],
        "findings": ["Only one scale bar."],
        "observations": [
            {"file": "a1.jpg", "name": "1", "col_px": 10.0 * i, "row_px": 5.0 * i,
             "residual_px": [0.01, -0.02], "used": True}
            for i in range(1, 5)
        ],
        "acceptance": {"LME": {"constant_mm": 0.05, "per_metre_mm": 0.02}, "lengths": [length]},
    }  # fmt: skip


def test_the_document_is_the_same_on_any_day_and_carries_the_result():
    one, two = survey_document(result(), "set"), survey_document(result(), "set")
    assert one == two
    assert one.startswith(b"%PDF")
    assert b"survey.json" in one


def test_of_many_photographs_only_as_many_are_named_as_can_be_read():
    many = result()
    photo = many["photos"][0]
    many["photos"] = [{**photo, "file": f"a{i}.jpg"} for i in range(200)]
    axes = per_photo_figure(many).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()][:2] == ["a0", "a4"]
    assert not axes.texts
    few = per_photo_figure(result()).axes[0]
    assert [text.get_text() for text in few.texts] == ["4", "0"]


def test_the_table_of_lengths_names_the_one_beyond_its_limit():
    measured = result()["acceptance"]
    assert _length_rows(measured)[1][-1] == "0.0560"
    measured["lengths"][0]["within"] = False
    assert _length_rows(measured)[1] == [
        "1–5", "300.0000", "300.0100", "+0.0100", "0.0040", "0.0560 exceeded",
    ]  # fmt: skip


def test_the_scene_holds_every_point_and_every_photograph_that_was_placed():
    page = survey_scene(result(), "Survey <x>")
    data = json.loads(re.search(r"const data = (\{.*\});", page)[1])
    assert len(data["points"]) == 8
    assert len(data["photos"]) == 2
    assert "<x>" not in page
    lengths = [np.linalg.norm(axis) for axis in data["points"][0]["axes"]]
    assert max(lengths) / min(lengths) == pytest.approx(3.0)


def test_the_text_tells_bars_and_findings():
    text = survey_text({**result(), "sigma0_by": {"coded": 1.2, "plain": 0.9}})
    assert "1.100 times what was expected (coded 1.200, plain 0.900);" in text
    assert "scale bar 1-3: 100.0020 mm, +0.0020" in text
    assert text.endswith("Only one scale bar.")


def test_every_picture_is_written_and_none_of_what_was_not_measured(tmp_path):
    measured = result()
    del measured["acceptance"]
    write_pictures(measured, tmp_path / "new")
    names = {"network.png", "rays.png", "residuals.png", "residuals_by_photograph.png"}
    assert {file.name for file in (tmp_path / "new").iterdir()} == names
    write_pictures(result(), tmp_path / "new")
    lengths = tmp_path / "new" / "lengths.png"
    assert lengths.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="folder"):
        write_pictures(measured, lengths)


def test_each_of_several_cameras_is_told_with_its_noise():
    one = {"parameters": ["f"], "values": [3000.0], "covariance": [[0.01]]}
    cameras = [{"name": "tele", "photos": 7, **one}, {"name": "wide", "photos": 5, **one}]
    by = {"coded, tele": 1.1, "coded, wide": 3.2, "plain, wide": 2.5}
    several = {**result(), "cameras": cameras, "sigma0_by": by}
    lines = survey_text(several).splitlines()
    assert "tele: 7 photographs, f 3000.00 px (sigma 0.10)" in lines[3]
    assert lines[3].endswith("expected: coded 1.100")
    assert lines[4].endswith("expected: coded 3.200, plain 2.500")
    assert survey_document(several, "set") != survey_document(result(), "set")
