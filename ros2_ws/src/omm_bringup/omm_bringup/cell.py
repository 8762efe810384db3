"""The nodes of a cell and their parameters: the same for `./omm demo` and the launch files."""

from dataclasses import replace
from pathlib import Path

from omm_bringup.processes import NodeSpec

CONTROLS = ("simulated", "linuxcnc")
CAMERAS = ("simulated", "gige")
# Where the simulated GigE camera answers, and the camera node looks for it.
GIGE_ADDRESS = "127.0.0.1"


def simulated_cell(
    run_folder: Path,
    *,
    scenario: str,
    seed: int,
    clamping_seed: int = -1,
    repeat: int = 1,
    camera: str = "simulated",
    control: str = "simulated",
    start_program: bool = False,
    namespace: str = "",
) -> tuple[NodeSpec, ...]:
    """Return recorder, estimator, camera and CNC bridge of a simulated cell.

    The recorder comes first, so that it is there from the first message to the last. The run's
    folder must hold `part.yaml` and `camera.yaml`: that is all the estimator gets. A namespace
    (`/mill1`) keeps two machines on one computer apart; their frames get it as a prefix.
    """
    part_file, calibration_file = str(run_folder / "part.yaml"), str(run_folder / "camera.yaml")
    known = {"part_file": part_file, "calibration_file": calibration_file}
    drawn: dict[str, str | int] = {"scenario": scenario, "seed": seed}
    if clamping_seed >= 0:
        drawn |= {"clamping_seed": clamping_seed}
    if repeat > 1:
        drawn |= {"repeat": repeat}
    frames = {"frame_prefix": f"{namespace.lstrip('/')}/"} if namespace else {}
    # A real LinuxCNC with simulated drives, which the bridge starts and ends.
    started = {"linuxcnc_cell": "three_axis_mill"} if control == "linuxcnc" else {}
    specs = (
        NodeSpec(
            package="omm_recorder",
            executable="recorder_node",
            name="recorder",
            parameters={"folder": str(run_folder), **known},
            ends_first=True,
        ),
        NodeSpec(
            package="omm_estimator",
            executable="estimator_node",
            name="estimator",
            parameters={**known, **frames},
        ),
        *_camera_nodes(camera, calibration_file, drawn, frames),
        NodeSpec(
            package="omm_cnc_bridge",
            executable="cnc_bridge_node",
            name="cnc_bridge",
            parameters={
                "control": control,
                "start_program": start_program,
                **started,
                **drawn,
                **frames,
            },
        ),
    )
    return tuple(replace(spec, namespace=namespace) for spec in specs)


def _camera_nodes(
    camera: str, calibration_file: str, drawn: dict[str, str | int], frames: dict[str, str]
) -> tuple[NodeSpec, ...]:
    # A camera that speaks the real protocol, in a process of its own.
    simulator = NodeSpec(
        package="omm_camera_driver",
        executable="gige_simulator_node",
        name="gige_simulator",
        parameters={"address": GIGE_ADDRESS, **drawn},
    )
    node = NodeSpec(
        package="omm_camera_driver",
        executable="camera_node",
        name="camera",
        parameters={
            "driver": camera,
            "device": GIGE_ADDRESS if camera == "gige" else "",
            "calibration_file": calibration_file,
            "trigger": "software",
            **drawn,
            **frames,
        },
    )
    return (simulator, node) if camera == "gige" else (node,)


def operators_page(run_folder: Path, *, port: int, stops: int) -> NodeSpec:
    """Return the operator's page for a cell whose program has so many stops."""
    return NodeSpec(
        package="omm_operator",
        executable="operator_node",
        name="operator",
        parameters={"port": port, "stops": stops, "part_file": str(run_folder / "part.yaml")},
    )
