"""Estimator and recorder together: nodes die, come late, and are given another part."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from estimator_bench import Bench, bench_in_own_domain, end, kill
from geometry_msgs.msg import PoseWithCovarianceStamped
from omm_interfaces.msg import PartEstimate
from omm_interfaces.srv import LeaveOutImage, LoadPart
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from omm_recording.repairing import repair
from omm_ros import qos
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


def test_an_image_that_is_left_out_on_request_is_left_out_of_the_recording_too(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    recorder = bench.start("omm_recorder", folder=tmp_path / "run")
    estimator = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
    bench.until_heard(2)
    with_all = bench.play([*halves[0], *halves[1]], images=8)
    third = with_all.images[2].stamp

    def ask(stamp: Time, leave_out: bool) -> object:
        request = LeaveOutImage.Request(stamp=stamp, leave_out=leave_out)
        return bench.call(LeaveOutImage, "/estimator/leave_out_image", request)

    unknown = ask(Time(sec=1), True)
    assert not unknown.success  # type: ignore[attr-defined]
    assert "no image of 1000000000 ns" in unknown.message  # type: ignore[attr-defined]
    assert ask(third, True).success  # type: ignore[attr-defined]
    bench.until(lambda: not bench.estimates[-1].images[2].used, "the image left out")
    live = bench.estimates[-1]
    assert live.images[2].reason == "left out on request"
    assert list(live.theta) != list(with_all.theta)
    end(estimator)
    end(recorder)
    solved = solve_run(tmp_path / "run").result
    assert [(i.used, i.reason or "") for i in solved.images] == [
        (i.used, i.reason) for i in live.images
    ]
    assert solved.solution.theta[0] == live.theta[0]
    assert len(solved.observations) == len(live.observations)


def test_an_image_taken_back_in_or_a_new_clamping_undoes_it(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    estimator = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
    bench.until_heard(1)
    first = bench.play(halves[0], images=4)
    stamp = first.images[0].stamp
    request = LeaveOutImage.Request(stamp=stamp, leave_out=True)
    bench.call(LeaveOutImage, "/estimator/leave_out_image", request)
    bench.until(lambda: not bench.estimates[-1].images[0].used, "the image left out")
    request.leave_out = False
    bench.call(LeaveOutImage, "/estimator/leave_out_image", request)
    bench.until(lambda: bench.estimates[-1].images[0].used, "the image taken back in")
    assert list(bench.estimates[-1].images) == list(first.images)
    request = LeaveOutImage.Request(stamp=stamp, leave_out=True)
    bench.call(LeaveOutImage, "/estimator/leave_out_image", request)
    bench.call(Trigger, "/estimator/new_clamping", Trigger.Request())
    bench.until(lambda: not bench.estimates[-1].images, "an empty estimate")
    assert bench.play(halves[0], images=4).images[0].used
    end(estimator)


def test_a_killed_estimators_pose_reaches_nobody_who_comes_late(
    bench: Bench, cell: Cell, halves: tuple[list[object], list[object]], tmp_path: Path
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    recorder = bench.start("omm_recorder", folder=tmp_path / "run")
    estimator = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
    bench.until_heard(2)
    assert bench.play([*halves[0], *halves[1]], images=8).determined
    kill(estimator)
    late: list[object] = []
    for kind, topic in (
        (PoseWithCovarianceStamped, "/omm/part_pose"),
        (PartEstimate, "/omm/estimate"),
        (TFMessage, "/tf"),
        (TFMessage, "/tf_static"),
    ):
        bench.node.create_subscription(kind, topic, late.append, qos.LATCHED)
    bench.idle(3.0)
    assert late == []
    end(recorder)
