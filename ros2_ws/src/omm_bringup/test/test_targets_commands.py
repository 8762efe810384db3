"""`./omm detect` and `./omm targets`, from arguments to exit status."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from omm_bringup.command_line import main
from omm_core.targets import TargetFamily
from omm_simulation.target_image import affine_plane, target_coverage


@pytest.fixture
def photographs(tmp_path):
    """Three files of target 42: PNG of 8 bit, TIFF of 16 bit, JPEG."""
    family = TargetFamily.by_name("metashape12")
    plane = affine_plane(centre_px=(80.25, 81.5), radius_px=15.0)
    cover = target_coverage(code=family.code_of(42), family=family, dot_radius_mm=1.0,
                            plane_of_pixel=plane, window=(0, 0, 160, 160), blur_px=0.8)  # fmt: skip
    image = 20.0 + 150.0 * cover
    cv2.imwrite(str(tmp_path / "a.png"), image.astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.tif"), (256 * image).astype(np.uint16))
    cv2.imwrite(str(tmp_path / "c.jpg"), image.astype(np.uint8))
    return tmp_path


def test_a_folder_of_images_is_detected_and_written_as_the_contract_says(photographs):
    out = photographs / "result.json"
    assert main(["detect", str(photographs), "--family", "metashape12", "--json", str(out)]) == 0
    entries = json.loads(out.read_text())
    assert [Path(entry["image"]).name for entry in entries] == ["a.png", "b.tif", "c.jpg"]
    for entry in entries:
        (target,) = entry["targets"]
        assert target["id"] == 42
        assert target["col_px"] == pytest.approx(80.25, abs=0.05)
        assert target["row_px"] == pytest.approx(81.5, abs=0.05)
        assert np.array(target["covariance_px2"]).shape == (2, 2)
        assert target["diameter_px"] == pytest.approx(30.0, abs=0.2)


def test_patterns_and_overlays(photographs, capsys):
    status = main(["detect", str(photographs / "*.png"), "--family", "metashape12", "--overlay",
                   str(photographs / "drawn")])  # fmt: skip
    assert status == 0
    drawn = cv2.imread(str(photographs / "drawn" / "a_targets.png"))
    assert drawn.shape == (160, 160, 3)
    assert (drawn[..., 0] != drawn[..., 1]).any()
    assert "1 targets" in capsys.readouterr().out


@pytest.mark.parametrize("damage", ["empty", "text", "cut"])
def test_a_corrupt_file_is_named_and_skipped(photographs, capsys, damage):
    good = (photographs / "a.png").read_bytes()
    data = {"empty": b"", "text": b"no image", "cut": good[: len(good) // 2]}[damage]
    (photographs / "bad.png").write_bytes(data)
    out = photographs / "result.json"
    status = main(["detect", str(photographs), "--family", "metashape12", "--json", str(out)])
    assert status == 1
    assert len(json.loads(out.read_text())) == 3
    assert "bad.png" in capsys.readouterr().err.replace("\n", "")


@pytest.mark.parametrize(
    "arguments",
    [["nowhere.png", "--family", "metashape12"], [__file__, "--family", "nobody12"]],
)
def test_bad_input_is_status_2(arguments):
    assert main(["detect", *arguments]) == 2


def test_a_sheet_is_written(tmp_path, capsys):
    pytest.importorskip("fpdf", reason="fpdf2 is not installed")
    out = tmp_path / "sheet.pdf"
    status = main(["targets", "--family", "metashape12", "--count", "6", "--dot-mm", "8",
                   "--out", str(out)])  # fmt: skip
    assert status == 0
    assert out.read_bytes().startswith(b"%PDF")
    assert "sectors must be misread" in capsys.readouterr().out
    assert main(["targets", "--family", "metashape12", "--ids", "999", "--dot-mm", "8"]) == 2


def test_plain_targets_and_ends_of_scale_bars_are_written(tmp_path, capsys):
    pytest.importorskip("fpdf", reason="fpdf2 is not installed")
    out = tmp_path / "sheet.pdf"
    assert main(["targets", "--plain", "30", "--dot-mm", "6", "--out", str(out)]) == 0
    assert "30 plain targets on 1 page" in capsys.readouterr().out
    coded = ["targets", "--family", "aicon12", "--dot-mm", "8", "--out", str(out)]
    assert main([*coded, "--ids", "11,12,21,22", "--bar-ends"]) == 0
    assert "- {ends: [21, 22], length_mm:" in capsys.readouterr().out
    assert main([*coded, "--ids", "11", "--bar-ends"]) == 2
    assert main([*coded, "--plain", "3"]) == 2
    assert main(["targets", "--ids", "11", "--dot-mm", "8"]) == 2


def test_help_needs_no_numba(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "numba", None)
    for command in ("detect", "targets"):
        with pytest.raises(SystemExit) as exit_:
            main([command, "--help"])
        assert exit_.value.code == 0
    assert "--family" in capsys.readouterr().out
