"""The compressed overlay: the image with its targets and, once known, their residuals."""

import subprocess
import sys
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from estimator_bench import Bench, bench_in_own_domain, end
from omm_interfaces.msg import PartEstimate, ResidualStatus, TargetObservation, TargetObservations
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from omm_operator.overlay_node import estimate_marks, jpeg
from omm_ros import qos
from omm_ros.conversions import image_message, time_from_ns

NODE = "import sys; from omm_operator.overlay_node import main; sys.exit(main())"
STAMP = 10**18


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    with bench_in_own_domain(monkeypatch) as bench:
        yield bench


def test_targets_are_drawn_where_they_were_found(bench: Bench) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", NODE, "--ros-args", "-p", "width_px:=324"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    seen: list[CompressedImage] = []
    node = bench.node
    node.create_subscription(CompressedImage, "/omm/overlay/compressed", seen.append, qos.IMAGE)
    found = node.create_publisher(TargetObservations, "/omm/observations", qos.OBSERVATIONS)
    bench.until(lambda: bench.image.get_subscription_count() > 0, "the node")
    bench.until(lambda: found.get_subscription_count() > 0, "its other ear")
    bench.idle(1.0)
    header = Header(stamp=time_from_ns(STAMP), frame_id="camera_optical")
    grey = np.full((486, 648), 90, np.uint8)
    bench.image.publish(image_message(grey, STAMP, "camera_optical"))
    bench.idle(0.5)
    target = TargetObservation(id=42, col_px=200.0, row_px=300.0)
    found.publish(TargetObservations(header=header, targets=[target]))
    bench.until(lambda: bool(seen), "the overlay")
    end(process)
    assert seen[0].header == header
    assert seen[0].format == "bgr8; jpeg compressed bgr8"
    image = cv2.imdecode(np.frombuffer(seen[0].data, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (243, 324, 3)
    drawn = np.abs(image.astype(int) - 90).max(axis=2) > 15
    cross = drawn[144:157, 94:107]
    assert cross.any(axis=0).all()  # its arms reach from side to side
    assert cross.any(axis=1).all()
    assert not drawn[:, 220:].any()


def test_residuals_are_those_of_the_image_and_only_where_there_are_some() -> None:
    told = [
        (STAMP, 1, [0.5, -0.25], True),
        (STAMP, 2, [np.nan, np.nan], False),
        (STAMP + 1, 3, [1.0, 1.0], True),
    ]
    estimate = PartEstimate(
        observations=[
            ResidualStatus(
                stamp=time_from_ns(s), target_id=i, residual_px=np.array(r), used=u, col_px=1.0
            )
            for s, i, r, u in told
        ]
    )
    marks = estimate_marks(estimate, STAMP)
    assert [(m.target_id, m.residual_px, m.used) for m in marks] == [
        (1, (0.5, -0.25), True),
        (2, None, False),
    ]


@pytest.mark.parametrize(
    ("width_px", "shape"), [(0, (40, 60, 3)), (30, (20, 30, 3)), (90, (40, 60, 3))]
)
def test_an_image_is_made_smaller_never_larger(width_px: int, shape: tuple[int, ...]) -> None:
    data = jpeg(np.zeros((40, 60, 3), np.uint8), width_px, 80)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == shape
