"""A stored result is published as the estimator published it, latched, and never beside another."""

import copy
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from estimator_bench import Bench, bench_in_own_domain, end
from whole_suite import ROOT

from omm_core.errors import InputError
from omm_core.session.result import MeasurementResult
from omm_estimator import conversions
from omm_estimator.stored import load_result
from omm_runs.solving import solve_run

NODE = "import sys; from omm_estimator.stored_result_node import main; sys.exit(main())"


@pytest.fixture(scope="module")
def result() -> MeasurementResult:
    return solve_run(ROOT / "test" / "data" / "bench").result


@pytest.fixture(scope="module")
def content(result: MeasurementResult) -> dict[str, object]:
    return json.loads(json.dumps(result.to_json_dict()))


@pytest.fixture
def file(content: dict[str, object], tmp_path: Path) -> Path:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    with bench_in_own_domain(monkeypatch) as bench:
        yield bench


def start(file: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", NODE, "--ros-args", "-p", f"result_file:={file}"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


@pytest.mark.parametrize("under", [None, "result"])
def test_a_stored_pose_is_the_live_one_to_the_bit(
    result: MeasurementResult, content: dict[str, object], tmp_path: Path, under: str | None
) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps({under: content} if under else content))
    stored, live = load_result(str(path)), conversions.pose_message(result)
    live.header.stamp = conversions.stored_pose(stored).header.stamp
    assert conversions.stored_pose(stored) == live
    estimate = conversions.stored_estimate(stored)
    whole = conversions.estimate_message(result, 0)
    for name in ("theta", "covariance", "expanded_uncertainty", "absolute_theta"):
        assert np.array_equal(getattr(estimate, name), getattr(whole, name))
    assert stored.stamp_ns == max(i.stamp_ns for i in result.images if i.used)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.update(converged=False), "is not determined"),
        (lambda c: c.update(determined=False), "is not determined"),
        (lambda c: c["theta"].pop("x_mm"), "x_mm"),
        (lambda c: c["theta"].update(x_mm=None), "x_mm"),
        (lambda c: c["covariance"].pop(), "7 rows of 7"),
        (lambda c: c["covariance"][0].__setitem__(1, 1.0), "symmetric"),
        (lambda c: c.update(images=[]), "images that were used"),
        (lambda c: c.pop("absolute"), "absolute"),
    ],
)
def test_what_is_no_result_is_told(
    content: dict[str, object], tmp_path: Path, change: object, told: str
) -> None:
    changed = copy.deepcopy(content)
    change(changed)  # type: ignore[operator]
    path = tmp_path / "result.json"
    path.write_text(json.dumps(changed))
    with pytest.raises(InputError, match=told):
        load_result(str(path))


def test_it_is_latched_and_ends_where_an_estimator_comes(bench: Bench, file: Path) -> None:
    process = start(file)
    bench.until(lambda: bool(bench.poses and bench.estimates), "the stored pose")
    assert bench.estimates[-1].determined
    assert np.isfinite(bench.poses[-1].pose.pose.position.x)
    kind = type(bench.poses[-1])
    other = bench.node.create_publisher(kind, "/omm/part_pose", 1)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "/omm/part_pose: 1 more publish it" in told
    bench.node.destroy_publisher(other)


def test_it_ends_cleanly_when_it_is_told_to(bench: Bench, file: Path) -> None:
    process = start(file)
    bench.until(lambda: bool(bench.poses), "the stored pose")
    end(process)
