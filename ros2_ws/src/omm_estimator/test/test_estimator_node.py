"""The estimator as a process over DDS: it estimates, accounts for every image, and starts anew."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from domain_coordinator import domain_id
from estimator_bench import Bench, bench_in_own_domain, end
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from omm_interfaces.srv import LoadPart
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from omm_estimator.node import EstimatorNode
from omm_ros import qos
from omm_ros.conversions import image_message
from omm_simulation.cell import Cell, draw, write_estimator_files
from omm_simulation.offline import Faults, ImageMessage, run
from omm_simulation.scenario import load_scenario


@pytest.fixture(scope="module")
def cell() -> Cell:
    return draw(load_scenario("bench"), 5)


@pytest.fixture(scope="module")
def messages(cell: Cell) -> list[object]:
    return list(run(cell))


@pytest.fixture
def bench(tmp_path: Path, cell: Cell, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """An estimator process in a domain of its own, and the bench beside it."""
    part, calibration = write_estimator_files(cell, tmp_path)
    with bench_in_own_domain(monkeypatch) as bench:
        process = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
        bench.until(lambda: bool(bench.estimates), "the estimator")
        bench.until_heard()
        yield bench
        end(process)


def test_a_run_gives_the_truth_within_its_covariance(
    bench: Bench, cell: Cell, messages: list[object]
) -> None:
    estimate = bench.play(messages, images=8)
    assert estimate.determined
    assert estimate.converged
    truth = np.array(list(cell.theta_own().values())) / [1, 1, 1, 1000, 1000, 1000, 1]
    sigma = np.sqrt(np.diag(np.array(estimate.covariance).reshape(7, 7)))
    assert np.all(np.abs(np.array(estimate.theta) - truth) < 4.5 * sigma)
    assert {t.id: t.images for t in estimate.targets} == {42: 2, 40: 2, 8: 2, 122: 2}
    x_m = pytest.approx(estimate.theta[3])
    bench.until(  # poses of the estimates before it may still be on their way
        lambda: bool(bench.poses) and bench.poses[-1].pose.pose.position.x == x_m,
        "the pose of the last estimate",
    )


def test_nothing_is_estimated_before_it_is_determined(bench: Bench, messages: list[object]) -> None:
    second_image = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][1]
    estimate = bench.play(messages[: second_image + 40], images=2)
    assert not estimate.determined
    assert np.all(np.isnan(estimate.theta))
    assert estimate.missing


def test_images_that_cannot_be_used_are_accounted_for_and_the_rest_is_solved(
    bench: Bench, cell: Cell
) -> None:
    faults = Faults(without_poses=frozenset({3}), moving=frozenset({6}))
    estimate = bench.play(list(run(cell, faults=faults)), images=8)
    refused = [image.reason for image in estimate.images if not image.used]
    assert len(refused) == 2
    assert any("gap" in reason or "no spindle pose" in reason for reason in refused)
    assert any("moved" in reason for reason in refused)
    assert estimate.determined


def test_an_image_of_another_size_is_refused_with_the_sizes(bench: Bench) -> None:
    bench.image.publish(image_message(np.zeros((480, 640), np.uint8), 10**18, "camera_optical"))
    bench.until(lambda: len(bench.estimates[-1].images) == 1, "the image's account")
    status = bench.estimates[-1].images[0]
    assert not status.used
    assert "2592" in status.reason
    assert "640" in status.reason


def test_images_that_come_faster_than_they_can_be_taken_are_counted_too(bench: Bench) -> None:
    statuses: dict[str, str] = {}

    def heard(array: DiagnosticArray) -> None:
        for status in array.status:
            statuses.update({value.key: value.value for value in status.values})

    bench.node.create_subscription(DiagnosticArray, "/diagnostics", heard, 10)
    burst = 200
    message = image_message(np.zeros((480, 640), np.uint8), 10**18, "camera_optical")
    for second in range(burst):
        message.header.stamp.sec = 10**9 + second
        bench.image.publish(message)
        if second == 0:  # which numbers came before the first one that is heard, nobody knows
            bench.until(lambda: len(bench.estimates[-1].images) == 1, "the first image")

    def accounted() -> int:
        return len(bench.estimates[-1].images) + int(statuses.get("missed images", 0))

    bench.until(lambda: accounted() == burst, "the account of all images", accounted)
    assert int(statuses["missed images"]) > 0


def test_a_new_clamping_and_another_part_forget_the_images(
    bench: Bench, messages: list[object], tmp_path: Path
) -> None:
    second_image = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][1]
    bench.play(messages[: second_image + 40], images=2)
    answer = bench.call(Trigger, "/estimator/new_clamping", Trigger.Request())
    assert answer.success  # type: ignore[attr-defined]
    bench.until(lambda: not bench.estimates[-1].images, "an empty estimate")
    wrong = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file="nowhere"))
    assert not wrong.success  # type: ignore[attr-defined]
    assert "nowhere" in wrong.message  # type: ignore[attr-defined]
    secret = tmp_path / "shadow"
    secret.write_text("root:$6$salt$hash:19000:0:99999:7:::\n")
    wrong = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file=str(secret)))
    assert not wrong.success  # type: ignore[attr-defined]
    assert "$6$" not in wrong.message  # type: ignore[attr-defined]
    other = tmp_path / "other.yaml"
    other.write_text((tmp_path / "part.yaml").read_text().replace("name: bench", "name: gantry"))
    right = bench.call(LoadPart, "/estimator/load_part", LoadPart.Request(part_file=str(other)))
    assert right.success  # type: ignore[attr-defined]
    bench.until(lambda: bench.estimates[-1].part == "gantry", "the other part")


def test_a_pose_that_no_longer_holds_is_revoked_for_late_listeners_too(
    bench: Bench, messages: list[object]
) -> None:
    frames: list[tuple[str, str]] = []

    def heard(message: TFMessage) -> None:
        frames.extend((f.header.frame_id, f.child_frame_id) for f in message.transforms)

    bench.node.create_subscription(TFMessage, "/tf", heard, qos.STATE)
    assert bench.play(messages, images=8).determined
    holding = {("machine", "part"), ("spindle", "taper")}
    bench.until(lambda: frames.count(("machine", "part")) > 3, "frames said again and again")
    assert holding <= set(frames)
    bench.call(Trigger, "/estimator/new_clamping", Trigger.Request())
    bench.until(lambda: bench.estimates[-1].revoked, "an estimate that revokes")
    revoking = bench.estimates[-1]
    assert "new clamping" in revoking.revoked_reason
    assert not revoking.determined
    assert np.all(np.isnan([*revoking.theta, *revoking.covariance]))
    late: list[PoseWithCovarianceStamped] = []
    bench.node.create_subscription(
        PoseWithCovarianceStamped, "/omm/part_pose", late.append, qos.LATCHED
    )
    bench.until(lambda: bool(late), "what is latched")
    for message in (late[0], bench.poses[-1]):
        assert np.isnan(message.pose.pose.position.x)
        assert message.pose.covariance[0] == -1.0
    frames.clear()
    bench.idle(1.5)
    assert not holding & set(frames)


@pytest.mark.parametrize("delay_s", [0.0, 0.03, 0.1, 0.3])
def test_ctrl_c_amid_messages_ends_it_cleanly(
    tmp_path: Path,
    cell: Cell,
    messages: list[object],
    monkeypatch: pytest.MonkeyPatch,
    delay_s: float,
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    with bench_in_own_domain(monkeypatch) as bench:
        process = bench.start("omm_estimator", part_file=part, calibration_file=calibration)
        bench.until(lambda: bool(bench.estimates), "the estimator")
        bench.until_heard()
        for message in messages:  # faster than it can take them
            bench.publish(message)
        time.sleep(delay_s)
        end(process)


@pytest.mark.parametrize("missing", ["part_file", "calibration_file"])
def test_without_its_files_it_says_so_and_ends_with_status_2(
    tmp_path: Path, cell: Cell, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    part, calibration = write_estimator_files(cell, tmp_path)
    files = {"part_file": part, "calibration_file": calibration, missing: tmp_path / "nowhere"}
    with bench_in_own_domain(monkeypatch) as bench:
        process = bench.start("omm_estimator", **files)
        told, _ = process.communicate(timeout=60)
    assert process.returncode == 2, told
    assert "nowhere" in told


def test_parameters_change_while_measuring_and_what_may_not_is_refused(
    bench: Bench, cell: Cell, messages: list[object]
) -> None:
    gamma_s = bench.play(messages, images=8).theta[6]
    given = [Parameter("gamma_s_rad", value=gamma_s), Parameter("model", value="6d")]
    for parameter in given:
        _set(bench, parameter, accepted=True)
    bench.until(lambda: bench.estimates[-1].model == "6d", "an estimate of the 6d model")
    bench.until(lambda: bench.estimates[-1].theta[6] == gamma_s, "the angle that was given")
    assert bench.estimates[-1].determined
    assert bench.estimates[-1].covariance[48] == 0.0
    assert "read-only" in _set(bench, Parameter("standstill_window_s", value=0.2), accepted=False)
    assert "7d" in _set(bench, Parameter("model", value="8d"), accepted=False)


def _set(bench: Bench, parameter: Parameter, *, accepted: bool) -> str:
    request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
    (result,) = bench.call(SetParameters, "/estimator/set_parameters", request).results  # type: ignore[attr-defined]
    assert result.successful == accepted, result.reason
    return str(result.reason)


def test_deactivated_it_takes_no_image_and_keeps_what_was_measured(
    bench: Bench, messages: list[object]
) -> None:
    second_image = [i for i, m in enumerate(messages) if isinstance(m, ImageMessage)][1]
    bench.play(messages[: second_image + 40], images=2)
    _change(bench, Transition.TRANSITION_DEACTIVATE)
    for message in messages:
        if isinstance(message, ImageMessage):
            bench.publish(message)
    _change(bench, Transition.TRANSITION_ACTIVATE)
    assert len(bench.estimates[-1].images) == 2
    assert len(bench.play(messages[second_image + 40 :], images=8).images) == 8
    _change(bench, Transition.TRANSITION_DEACTIVATE)
    _change(bench, Transition.TRANSITION_CLEANUP)
    _change(bench, Transition.TRANSITION_CONFIGURE)
    _change(bench, Transition.TRANSITION_ACTIVATE)
    bench.until(lambda: not bench.estimates[-1].images, "an empty estimate")


def _change(bench: Bench, transition: int) -> None:
    request = ChangeState.Request(transition=Transition(id=transition))
    assert bench.call(ChangeState, "/estimator/change_state", request).success  # type: ignore[attr-defined]


def test_an_estimator_that_can_get_nothing_does_not_say_that_it_is_fine(bench: Bench) -> None:
    lines: dict[str, tuple[bytes, str]] = {}

    def heard(array: DiagnosticArray) -> None:
        lines.update({s.name: (s.level, s.message) for s in array.status})

    def says(words: str) -> bool:
        level, message = lines.get("estimator: images", (DiagnosticStatus.OK, ""))
        return level != DiagnosticStatus.OK and words in message

    bench.node.create_subscription(DiagnosticArray, "/diagnostics", heard, 10)
    bench.until(lambda: says("no spindle pose for"), "word of missing poses", lambda: lines)
    change = Transition(id=Transition.TRANSITION_DEACTIVATE)
    bench.call(ChangeState, "/estimator/change_state", ChangeState.Request(transition=change))
    bench.until(lambda: says("not active"), "word of being inactive", lambda: lines)
    bench.node.destroy_publisher(bench.pose)
    change = Transition(id=Transition.TRANSITION_ACTIVATE)
    bench.call(ChangeState, "/estimator/change_state", ChangeState.Request(transition=change))
    bench.until(lambda: says("nobody publishes /cnc/spindle_pose"), "word of it", lambda: lines)


def test_health_is_told_while_kernels_are_still_compiled() -> None:
    """That takes half a minute where they are not there yet: nothing is subscribed to then."""
    with domain_id() as own:
        rclpy.init(args=[], domain_id=own)
        node = EstimatorNode()
        try:
            node._diagnostics.publish()
        finally:
            node.destroy_node()
            rclpy.shutdown()
