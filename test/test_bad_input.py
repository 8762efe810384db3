"""What cannot be used is refused with a clear message and status, and nothing is left behind."""

import shutil
from pathlib import Path

import pytest
from whole_suite import Omm

CASES = {
    "no such run": (["nowhere"], "nowhere"),
    "no such part file": (["{run}", "--part", "nowhere.yaml"], "nowhere.yaml"),
    "no such calibration": (["{run}", "--calibration", "nowhere.yaml"], "nowhere.yaml"),
    "not YAML": (["{run}", "--part", "{broken}"], "broken.yaml"),
    "a family nobody knows": (["{run}", "--part", "{family}"], "metashape99"),
    "a lens model nobody knows": (["{run}", "--calibration", "{lens}"], "fisheye"),
    "another sensor": (["{run}", "--calibration", "{sensor}"], "1000"),
    "another model": (["{run}", "--model", "8d"], "8d"),
    "a text file as recording": (["{text}"], "text.mcap"),
}


@pytest.fixture
def files(bench_run: Path, tmp_path: Path) -> dict[str, Path]:
    part, camera = (bench_run / "part.yaml").read_text(), (bench_run / "camera.yaml").read_text()
    contents = {
        "broken.yaml": "part: [unfinished",
        "family.yaml": part.replace("metashape12", "metashape99"),
        "lens.yaml": camera.replace("brown_photogrammetric", "fisheye"),
        "sensor.yaml": camera.replace("2592", "1000"),
        "text.mcap": "this is no recording",
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content)
    return {"run": bench_run, **{name.split(".")[0]: tmp_path / name for name in contents}}


@pytest.mark.parametrize("case", CASES)
def test_solve_refuses_what_it_cannot_use(
    case: str, files: dict[str, Path], omm: Omm, tmp_path: Path
) -> None:
    arguments, named = CASES[case]
    out = tmp_path / "out.json"
    before = set(tmp_path.iterdir())
    done = omm("solve", *[a.format(**files) for a in arguments], "--json", out, status=2)
    assert named in done.stderr
    assert "Traceback" not in done.stderr
    assert set(tmp_path.iterdir()) == before


def test_a_recording_that_was_cut_short_is_told(bench_run: Path, omm: Omm, tmp_path: Path) -> None:
    whole = (bench_run / "run.mcap").read_bytes()
    for name in ("part.yaml", "camera.yaml"):
        shutil.copy(bench_run / name, tmp_path / name)
    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) // 20])
    done = omm("solve", tmp_path / "run.mcap", status=2)
    assert "Traceback" not in done.stderr
    assert "cut short" in done.stderr
    assert "./omm repair" in done.stderr


def test_too_few_targets_are_told_in_words(bench_run: Path, omm: Omm, tmp_path: Path) -> None:
    text = (bench_run / "part.yaml").read_text()
    head, *targets = text.split("- id:")
    (tmp_path / "two.yaml").write_text("- id:".join([head, *targets[:1]]))
    done = omm("solve", bench_run, "--part", tmp_path / "two.yaml", status=1)
    assert "Traceback" not in done.stderr
    assert "target" in done.stderr + done.stdout


def test_targets_that_are_not_on_the_part_appear_as_unused(
    bench_run: Path, omm: Omm, tmp_path: Path
) -> None:
    import json

    text = (bench_run / "part.yaml").read_text()
    (tmp_path / "other.yaml").write_text(text.replace("- id: 122", "- id: 121"))
    omm("solve", bench_run, "--part", tmp_path / "other.yaml", "--json", tmp_path / "out.json")
    observations = json.loads((tmp_path / "out.json").read_text())["observations"]
    strangers = [o for o in observations if o["target_id"] == 122]
    assert len(strangers) == 2
    assert not any(o["used"] for o in strangers)
    assert all(o["reason"] for o in strangers)


def test_a_command_that_is_none_is_told_with_those_that_are(omm: Omm) -> None:
    assert "solve" in omm("slove", status=2).stderr
