"""What measure.launch.py starts: every parameter file fits its node, in any namespace."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not there")

import rclpy
from rclpy.node import Node

from omm_bringup.launch_arguments import check_names
from omm_bringup.parameter_tables import parameters_of
from omm_bringup.station import CAMERAS, CONTROLS, overlay, page, scene, station, stored_result
from omm_camera_driver.parameters import Parameters as CameraParameters
from omm_cnc_bridge.parameters import Parameters as BridgeParameters
from omm_core.errors import InputError
from omm_ros.parameters import declare

CONFIG = Path(__file__).parents[1] / "config"
FILES = [*(f"camera_{name}" for name in CAMERAS), *(f"control_{name}" for name in CONTROLS)]


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    paths = {"part_file": tmp_path / "part.yaml", "calibration_file": tmp_path / "camera.yaml"}
    for path in paths.values():
        path.write_text("there\n")
    return {name: str(path) for name, path in paths.items()}


@pytest.fixture
def node_with(request: pytest.FixtureRequest) -> Iterator[object]:
    context = rclpy.Context()

    def make(name: str, namespace: str, file: Path) -> Node:
        context.init(args=["--ros-args", "--params-file", str(file)])
        return Node(name, namespace=namespace, context=context)

    yield make
    context.try_shutdown()


@pytest.mark.parametrize("namespace", ["/", "/mill1"])
@pytest.mark.parametrize("name", FILES)
def test_every_parameter_file_reaches_its_node_and_fits(
    name: str, namespace: str, node_with: object
) -> None:
    of_camera = name.startswith("camera")
    node = node_with("camera" if of_camera else "cnc_bridge", namespace, CONFIG / f"{name}.yaml")
    parameters = declare(node, CameraParameters if of_camera else BridgeParameters)
    kind = parameters.driver if of_camera else parameters.control
    assert kind == name.partition("_")[2]
    node.destroy_node()


def test_diagnostics_file_names_every_station() -> None:
    content = yaml.safe_load((CONFIG / "diagnostics.yaml").read_text())
    analyzers = [v for v in content["/**"]["ros__parameters"].values() if isinstance(v, dict)]
    lines = {line for analyzer in analyzers for line in analyzer["contains"]}
    assert lines == {"camera:", "cnc_bridge:", "estimator:", "recorder:"}


def test_a_namespace_reaches_every_node_and_its_frames(files: dict[str, str]) -> None:
    specs = station(camera="gige", control="opcua", namespace="/mill1", **files)
    assert {spec.namespace for spec in specs} == {"/mill1"}
    prefixes = {spec.name: spec.parameters.get("frame_prefix") for spec in specs}
    assert prefixes.pop("recorder") is None
    assert set(prefixes.values()) == {"mill1/"}


def test_a_namespace_reaches_what_shows_and_what_is_published_again(
    files: dict[str, str],
) -> None:
    result = stored_result(files["part_file"], publish_tf=False, namespace="/mill1")
    specs = (scene(**files, namespace="/mill1"), result)
    assert overlay("/mill1").namespace == "/mill1"
    assert {spec.namespace for spec in specs} == {"/mill1"}
    assert {spec.parameters["frame_prefix"] for spec in specs} == {"mill1/"}
    assert result.parameters["publish_tf"] is False


@pytest.mark.parametrize("kind", ["overlay", "scene", "stored_result", "operator"])
def test_what_stands_beside_a_station_is_started_with_parameters_that_it_has(
    kind: str, files: dict[str, str], tmp_path: Path
) -> None:
    machine = tmp_path / "mill.urdf"
    machine.write_text("there\n")
    spec = {
        "overlay": lambda: overlay("/mill1"),
        "scene": lambda: scene(**files, machine_file=str(machine), namespace="/mill1"),
        "stored_result": lambda: stored_result(files["part_file"], namespace="/mill1"),
        "operator": lambda: page("8765", machine_file=str(machine), namespace="/mill1"),
    }[kind]()
    assert spec.name == kind
    known = {f.name for f in dataclasses.fields(parameters_of(kind))}
    assert set(spec.parameters) <= known


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"camera": "usb"}, "camera: expected one of gige"),
        ({"control": "fanuc"}, "control: expected one of linuxcnc"),
        ({"part_file": ""}, "part_file: expected a file"),
        ({"calibration_file": "nowhere.yaml"}, "calibration_file: expected a file"),
        ({"machine_file": "nowhere.urdf"}, "machine_file: expected a file"),
    ],
)
def test_what_is_missing_is_told_before_anything_starts(
    files: dict[str, str], changed: dict[str, str], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        station(**{"camera": "gige", "control": "linuxcnc", **files, **changed})


def test_a_misspelt_launch_argument_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="Did you mean part_file"):
        check_names(["part_file", "camera"], ["camera", "part_fil"])
