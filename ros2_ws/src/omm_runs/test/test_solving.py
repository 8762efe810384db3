"""A recording gives the same answer whenever, wherever and however it is solved."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from omm_bringup.command_line import main as omm
from omm_core.errors import InputError
from omm_recording.reading import Recording
from omm_recording.rosbag2_format import TopicQos
from omm_recording.writing import RecordingOptions, RecordingWriter, TopicToRecord
from omm_runs.solving import SolveRunOptions, solve_run

# mm and rad: what the bench recording of an independent program must be solved to.
LARGEST_ERRORS = {
    "alpha_rad": 3e-6,
    "beta_rad": 3e-6,
    "gamma_rad": 1e-6,
    "x_mm": 0.001,
    "y_mm": 0.001,
    "z_mm": 0.003,
    "gamma_s_rad": 6e-6,
}


def result_text(run: Path, options: SolveRunOptions | None = None) -> str:
    return json.dumps(solve_run(run, options).result.to_json_dict())


@pytest.fixture(scope="module")
def solved_bench(bench: Path) -> str:
    return result_text(bench)


def again(source: Path, target: Path, order: Any = None, files: bool = False) -> Path:
    """Record the messages of a recording once more, in another order."""
    writer = RecordingWriter(target / "run.mcap", RecordingOptions(compression="none"))
    if files:
        for name in ("part.yaml", "camera.yaml"):
            writer.add_file(name, (source / name).read_bytes(), 1)
    with Recording(source) as recording:
        for topic in recording.topics.values():
            writer.add_topic(
                TopicToRecord(
                    name=topic.name,
                    type_name=topic.type_name,
                    definition=topic.definition,
                    type_hash="",
                    qos=TopicQos(),
                )
            )
        messages = list(recording.messages())
    for number, index in enumerate(range(len(messages)) if order is None else order):
        m = messages[index]
        writer.write(m.topic, m.sequence, number, m.publish_time_ns, m.data)
    writer.close({})
    return target


def test_the_bench_recording_is_solved_to_micrometres(bench: Path, solved_bench: str) -> None:
    result = json.loads(solved_bench)
    truth = json.loads((bench / "truth.json").read_text())["theta"]
    sigma = np.sqrt(np.diag(result["covariance"]))
    for k, (name, largest) in enumerate(LARGEST_ERRORS.items()):
        error = abs(result["theta"][name] - truth[name])
        assert error <= largest, name
        assert error <= 4.0 * sigma[k], name
    assert result["rms_px"] <= 0.003


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_cores_does_not_matter(bench: Path, solved_bench: str, threads: int) -> None:
    assert result_text(bench, SolveRunOptions(threads=threads)) == solved_bench


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_of_arrival_does_not_matter(
    bench: Path, solved_bench: str, tmp_path: Path, seed: int
) -> None:
    order = np.random.default_rng(seed).permutation(568)
    shuffled = again(bench, tmp_path / "run", order, files=True)
    assert result_text(shuffled) == solved_bench


def test_one_file_alone_is_enough(bench: Path, solved_bench: str, tmp_path: Path) -> None:
    run = again(bench, tmp_path / "run", files=True)
    alone = tmp_path / "elsewhere.mcap"
    shutil.move(run / "run.mcap", alone)
    shutil.rmtree(run)
    assert result_text(alone) == solved_bench


def test_a_part_file_beside_that_is_not_the_recorded_one_is_told_of(
    bench: Path, tmp_path: Path
) -> None:
    run = again(bench, tmp_path / "run", files=True)
    shutil.copy(bench / "part.yaml", run)
    assert solve_run(run).notices == ()
    (run / "part.yaml").write_text((bench / "part.yaml").read_text().replace("1500", "1501"))
    assert "is not the part.yaml that was recorded" in solve_run(run).notices[0]


def test_images_can_be_left_out(bench: Path) -> None:
    stamp = json.loads((bench / "truth.json").read_text())["images"][2]["stamp_ns"]
    result = solve_run(bench, SolveRunOptions(without=frozenset([stamp]))).result
    (image,) = [i for i in result.images if not i.used]
    assert (image.stamp_ns, image.reason) == (stamp, "left out on request")
    with pytest.raises(InputError, match="Expected stamps of recorded images"):
        solve_run(bench, SolveRunOptions(without=frozenset([42])))


def test_in_6d_the_clamping_angle_is_as_given(bench: Path) -> None:
    solution = solve_run(
        bench, SolveRunOptions(settings={"model": "6d", "gamma_s_rad": 1e-4})
    ).result.solution
    assert solution.theta[6] == pytest.approx(1e-4, abs=1e-12)
    assert not solution.covariance[6].any()
    assert not solution.covariance[:, 6].any()


def test_without_part_file_it_is_told_how_to_name_one(bench: Path, tmp_path: Path) -> None:
    shutil.copy(bench / "run.mcap", tmp_path)
    with pytest.raises(InputError, match="--part FILE"):
        solve_run(tmp_path)


def test_images_can_be_read_again(bench: Path) -> None:
    images = list(solve_run(bench).images())
    truth = json.loads((bench / "truth.json").read_text())
    assert [stamp for stamp, _ in images] == [i["stamp_ns"] for i in truth["images"]]


# --- the command ------------------------------------------------------------------------------


def test_the_command_prints_a_table_and_writes_json(
    bench: Path, solved_bench: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "result.json"
    assert omm(["solve", str(bench), "--json", str(out)]) == 0
    assert json.loads(out.read_text()) == json.loads(solved_bench)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[5:12]] == [
        *("alpha", "beta", "gamma", "x", "y", "z", "gamma_s")
    ]


def few_images(bench: Path, folder: Path) -> Path:
    with Recording(bench) as recording:
        topics = [m.topic for m in recording.messages()]
    images = [k for k, topic in enumerate(topics) if topic == "/camera/image_raw"]
    order = [k for k in range(len(topics)) if k not in images[1:]]
    return again(bench, folder, order, files=True)


def test_too_few_images_is_status_1_and_leaves_nothing(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = few_images(bench, tmp_path / "run")
    out = tmp_path / "out"
    out.mkdir()
    assert omm(["solve", str(run), "--json", str(out / "r.json")]) == 1
    assert "cannot be solved" in capsys.readouterr().err
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("bad", ["cut", "text", "absent", "no part", "json nowhere"])
def test_bad_input_is_status_2_and_leaves_nothing(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], bad: str
) -> None:
    run, out = tmp_path / "run", tmp_path / "out"
    run.mkdir()
    out.mkdir()
    for name in ("run.mcap", "part.yaml", "camera.yaml"):
        shutil.copy(bench / name, run)
    target = out / "r.json"
    if bad == "cut":
        (run / "run.mcap").chmod(0o600)
        with (run / "run.mcap").open("r+b") as file:
            file.truncate(5_000_000)
    elif bad == "text":
        (run / "run.mcap").unlink()
        (run / "run.mcap").write_text("part: {}\n")
    elif bad == "absent":
        (run / "run.mcap").unlink()
    elif bad == "no part":
        (run / "part.yaml").unlink()
    else:
        target = out / "nowhere" / "r.json"
    assert omm(["solve", str(run), "--json", str(target)]) == 2
    assert capsys.readouterr().err.startswith("omm: ")
    assert list(out.iterdir()) == []


def test_one_bad_file_does_not_stop_the_rest(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_text("no recording")
    table = tmp_path / "table.csv"
    runs = [str(bench), str(bad), str(bench)]
    assert omm(["solve", *runs, "--jobs", "2", "--csv", str(table)]) == 1
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == runs
    assert [row["status"] for row in rows] == ["solved", "refused", "solved"]
    assert "not one" in rows[1]["message"]
    assert {k: v for k, v in rows[0].items() if k != "run"} == {
        k: v for k, v in rows[2].items() if k != "run"
    }
    assert "3 of 3 runs" in capsys.readouterr().err


# --- the machine ------------------------------------------------------------------------------

MACHINE = """machine: {name: mill, urdf: mill.urdf}
uncertainty: {stop_sigma_mm: 0.004, geometry_sigma_mm: 0.02, geometry_length_mm: 700}
"""


def test_what_is_declared_of_the_machine_is_taken_and_not_estimated(
    bench: Path, tmp_path: Path
) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE)
    free = solve_run(bench).result.to_json_dict()
    told = solve_run(bench, SolveRunOptions(machine_file=tmp_path / "m.yaml")).result.to_json_dict()
    assert "stop_sigma_mm" in free["machine"]["estimated"]
    assert not free["absolute"]["declared"]
    assert told["machine"]["estimated"] == []
    assert told["machine"]["stop_sigma_mm"] == 0.004
    assert told["machine"]["geometry_sigma_mm"] == 0.02
    assert told["absolute"]["declared"]
    # The bench is exact: far better than that machine, which is said.
    assert any("more exact than its file declares" in words for words in told["remarks"])


def test_a_urdf_declares_nothing(bench: Path, tmp_path: Path, solved_bench: str) -> None:
    (tmp_path / "mill.urdf").write_text("<robot name='mill'/>")
    options = SolveRunOptions(machine_file=tmp_path / "mill.urdf")
    assert result_text(bench, options) == solved_bench


def test_a_machine_file_inside_the_recording_serves_where_nobody_measured_live(
    bench: Path, tmp_path: Path
) -> None:
    run = again(bench, tmp_path, files=True)
    (tmp_path / "machine.yaml").write_text(MACHINE)
    solved = solve_run(run)
    assert solved.machine is not None
    assert solved.result.solution.machine.estimated == ()


def test_a_recording_of_before_with_a_machine_sigma_solves(bench: Path) -> None:
    """0 was "taken as exact" and means "estimated" now; above 0 it is the repeatability."""
    settings = {"machine_sigma_mm": 0.0}
    assert result_text(bench, SolveRunOptions(settings=settings)) == result_text(bench)
    told = solve_run(bench, SolveRunOptions(settings={"machine_sigma_mm": 0.002}))
    assert told.result.solution.machine.stop_sigma_mm.median == 0.002
