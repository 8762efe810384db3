"""./omm calibrate --check: statuses and words for what cannot be checked."""

import pytest
import yaml
from whole_suite import shared_data

from omm_bringup.command_line import main

BENCH = shared_data("bench")


@pytest.mark.parametrize(
    ("run", "more", "status", "said"),
    [
        ("{tmp}/none.mcap", [], 2, "does not exist"),
        ("{tmp}", [], 2, "got none"),
        ("{tmp}/bare.yaml", [], 2, "not one"),
        ("{bench}", ["--part", "{tmp}/none.yaml"], 2, "no such file"),
        ("{bench}", ["--calibration", "{tmp}/none.yaml"], 2, "no such file"),
        ("{bench}", ["--calibration", "{tmp}/small.yaml"], 2, "640 x 480"),
        ("{bench}", ["--machine", "{tmp}/bare.yaml"], 2, "'urdf' is missing"),
        ("{bench}", ["--part", "{tmp}/one.yaml"], 1, "at least 3"),
        ("{bench}", ["--out", "{tmp}/camera.yaml"], 2, "--json"),
    ],
)
def test_what_cannot_be_checked_is_said_and_leaves_no_file(
    tmp_path, capsys, run, more, status, said
):
    part = yaml.safe_load((BENCH / "part.yaml").read_text())
    camera = yaml.safe_load((BENCH / "camera.yaml").read_text())
    camera["camera"] |= {"width_px": 640, "height_px": 480}
    (tmp_path / "one.yaml").write_text(yaml.safe_dump({**part, "targets": part["targets"][:1]}))
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(camera))
    (tmp_path / "bare.yaml").write_text("machine: {name: mill 1}")
    words = [word.format(tmp=tmp_path, bench=BENCH) for word in [run, *more]]
    out = tmp_path / "check.json"
    assert main(["calibrate", "--json", str(out), "--check", *words]) == status
    assert said in capsys.readouterr().err
    assert not out.exists()
    assert not (tmp_path / "camera.yaml").exists()
