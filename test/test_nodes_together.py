"""Estimator and recorder together: nodes die, come late, and are given another part."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from estimator_bench import Bench, bench_in_own_domain, end, kill
from omm_interfaces.srv import LoadPart

from omm_recording.repairing import repair
from omm_runs.solving import solve_run
from omm_simulation.cell import Cell, draw, write_estimator_files
from omm_simulation.offline import ImageMessage, run
from omm_simulation.scenario import load_scenario


@pytest.fixture(scope="module")
def cell() -> Cell:
    return draw(load_scenario("bench"), 5)


@pytest.fixture(scope="module")
def halves(cell: Cell) -> tuple[list[object], list[object]]:
    """A run in two parts of four images each."""
    messages: list[object] = list(run(cell))
    fourth = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][3]
    return messages[: fourth + 40], messages[fourth + 40 :]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """The machine, which was there first."""
    with bench_in_own_domain(monkeypatch) as bench:
        yield bench


def test_an_estimator_that_dies_is_replaced_and_the_recording_has_all(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    files = {"part_file": part, "calibration_file": calibration}
    recorder = bench.start("omm_recorder", folder=tmp_path / "run")
    dying = bench.start("omm_estimator", **files)
    bench.until_heard(2)
    bench.play(halves[0], images=4)
    kill(dying)
    bench.estimates.clear()
    fresh = bench.start("omm_estimator", **files)
    bench.until(lambda: bool(bench.estimates), "the new estimator")
    bench.until_heard(2)
    bench.play(halves[1], images=4)
    end(fresh)
    end(recorder)
    solved = solve_run(tmp_path / "run").result
    assert len(solved.images) == 8
    assert solved.determined


def test_a_recorder_that_dies_leaves_what_it_had_and_disturbs_nobody(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    estimator = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
    dying = bench.start("omm_recorder", folder=tmp_path / "run")
    bench.until_heard(2)
    bench.play(halves[0], images=4)
    bench.idle(1.5)  # what is older than a second is on the disk
    kill(dying)
    assert bench.play(halves[1], images=8).determined
    end(estimator)
    (left,) = (tmp_path / "run").glob("*.mcap*")
    repaired = tmp_path / "repaired.mcap"
    repair(left, repaired)
    solved = solve_run(repaired).result
    assert len(solved.images) == 4


def test_a_part_that_is_changed_while_recording_is_the_one_that_is_solved(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(part.read_text().replace("name: bench", "name: another"))
    recorder = bench.start("omm_recorder", folder=tmp_path / "run")
    estimator = bench.start("omm_estimator", part_file=wrong, calibration_file=calibration)
    bench.until_heard(2)
    bench.play(halves[0], images=4)
    answer = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file=str(part)))
    assert answer.success  # type: ignore[attr-defined]
    bench.until(lambda: bench.estimates[-1].part == "bench", "the other part")
    live = bench.play(halves[1], images=4)
    end(estimator)
    end(recorder)
    solved = solve_run(tmp_path / "run")
    assert solved.part.name == live.part == "bench"
    assert len(solved.result.images) == len(live.images) == 4
    assert solved.result.missing == tuple(live.missing)
