"""Every node refuses a parameter that it does not have, and tells which it has."""

import dataclasses
import importlib
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")

NODES = {
    "omm_camera_driver.node": ("Parameters", "exposre_us:=5", "exposure_us"),
    "omm_camera_driver.drivers.gige.simulator_node": ("Parameters", "adress:=::1", "address"),
    "omm_cnc_bridge.node": ("Parameters", "contrl:=opcua", "control"),
    "omm_estimator.node": ("Parameters", "part_fil:=part.yaml", "part_file"),
    "omm_estimator.stored_result_node": ("Parameters", "result_fil:=r.json", "result_file"),
    "omm_operator.node": ("Parameters", "prt:=8766", "port"),
    "omm_operator.overlay_node": ("Parameters", "widt_px:=5", "width_px"),
    "omm_operator.scene_node": ("Parameters", "part_fil:=part.yaml", "part_file"),
    "omm_recorder.node": ("Parameters", "foldr:=runs", "folder"),
    "omm_recorder.replay": ("ReplayParameters", "rat:=2.0", "rate"),
}


def _run(module: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    program = f"import sys; from {module} import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("module", NODES)
def test_a_misspelt_parameter_is_refused_with_the_nearest_name(module):
    _, misspelt, meant = NODES[module]
    done = _run(module, "--ros-args", "-p", misspelt)
    assert done.returncode == 2, done.stderr
    said = done.stderr + done.stdout
    assert f"Parameter {misspelt.partition(':=')[0]}:" in said
    assert f"Did you mean {meant}?" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("module", NODES)
def test_help_names_every_parameter_with_its_default(module):
    kind = getattr(importlib.import_module(module), NODES[module][0])
    done = _run(module, "--help")
    assert done.returncode == 0, done.stderr
    lines = {line.strip() for line in done.stdout.splitlines()}
    assert {field.name for field in dataclasses.fields(kind)} <= lines
    assert not done.stdout.startswith("None")


def test_a_node_without_parameters_answers_help_too():
    done = _run("omm_operator.measuring", "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Start the program")
