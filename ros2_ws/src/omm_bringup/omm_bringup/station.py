"""The nodes of a measuring station with real devices, as the launch files start them."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from omm_bringup.processes import NodeSpec
from omm_core.errors import InputError

CAMERAS = ("gige", "usb3", "v4l2", "simulated")
CONTROLS = ("linuxcnc", "opcua", "mtconnect", "simulated")

# launch asks a process to end (SIGINT), asks again (SIGTERM) and kills it, by default 10 s later. A
# recorder may have gigabytes waiting for a slow disk then. omm@.service waits longer than both.
RECORDER_PATIENCE_S = {"sigterm_timeout": 120, "sigkill_timeout": 30}


def station(
    *,
    camera: str,
    control: str,
    part_file: str,
    calibration_file: str,
    machine_file: str = "",
    folder: str = "",
    record: bool = True,
    namespace: str = "",
) -> tuple[NodeSpec, ...]:
    """Return camera, CNC bridge, estimator and recorder.

    Parameters
    ----------
    camera, control : one of `CAMERAS`, `CONTROLS`, or a parameter file of one's own
    part_file, calibration_file : what is measured, and with which camera
    machine_file : URDF or machine.yaml; the controls that are real need it
    folder : where the recorder writes; empty: a new one in runs/
    record : whether to record
    namespace : the machine's, where there are several: `/mill1`

    Raises
    ------
    InputError
        A file is missing.
    """
    files = _resolved(part_file=part_file, calibration_file=calibration_file)
    frames = _frames(namespace)
    machine = _machine(machine_file)
    return (
        *((_recorder(files, folder, namespace),) if record else ()),
        NodeSpec(
            package="omm_estimator",
            executable="estimator_node",
            name="estimator",
            namespace=namespace,
            parameters={**files, **frames},
        ),
        NodeSpec(
            package="omm_camera_driver",
            executable="camera_node",
            name="camera",
            namespace=namespace,
            parameters={"calibration_file": files["calibration_file"], **frames},
            parameter_file=parameter_file("camera", camera, CAMERAS),
        ),
        NodeSpec(
            package="omm_cnc_bridge",
            executable="cnc_bridge_node",
            name="cnc_bridge",
            namespace=namespace,
            parameters={**machine, **frames},
            parameter_file=parameter_file("control", control, CONTROLS),
        ),
    )


def _frames(namespace: str) -> dict[str, str]:
    return {"frame_prefix": f"{namespace.strip('/')}/"} if namespace else {}


def _machine(machine_file: str) -> dict[str, str]:
    return _resolved(machine_file=machine_file) if machine_file else {}


def _resolved(**paths: str) -> dict[str, str]:
    """Return absolute paths; raise InputError where a file is missing."""
    for name, path in paths.items():
        if not path or not Path(path).is_file():
            raise InputError(f"{name}: expected a file, got {path!r}.")
    return {name: str(Path(path).resolve()) for name, path in paths.items()}


def _recorder(files: dict[str, str], folder: str, namespace: str) -> NodeSpec:
    return NodeSpec(
        package="omm_recorder",
        executable="recorder_node",
        name="recorder",
        namespace=namespace,
        parameters={**files, **({"folder": folder} if folder else {})},
        ends_first=True,
    )


def page(where: str, *, machine_file: str = "", namespace: str = "") -> NodeSpec:
    """Make the operator's page beside a station; which part it is, the estimator tells.

    Parameters
    ----------
    where : the page's port, or a parameter file for the node ``operator``

    Raises
    ------
    InputError
        It is neither.
    """
    of_port = where.isascii() and where.isdigit()
    parameters: dict[str, str | int] = {"port": int(where)} if of_port else {}
    parameters |= _machine(machine_file)
    return NodeSpec(
        package="omm_operator",
        executable="operator_node",
        name="operator",
        namespace=namespace,
        parameters=parameters,
        parameter_file=None if of_port else _own_file("page", where, "a port"),
    )


def overlay(namespace: str = "") -> NodeSpec:
    """Make the node that publishes images with what was found in them."""
    return NodeSpec(
        package="omm_operator", executable="overlay_node", name="overlay", namespace=namespace
    )


def scene(
    *, part_file: str, calibration_file: str = "", machine_file: str = "", namespace: str = ""
) -> NodeSpec:
    """Make the node that shows part, camera and machine in RViz and Foxglove.

    Raises
    ------
    InputError
        A file is missing.
    """
    camera = _resolved(calibration_file=calibration_file) if calibration_file else {}
    return NodeSpec(
        package="omm_operator",
        executable="scene_node",
        name="scene",
        namespace=namespace,
        parameters={
            **_resolved(part_file=part_file),
            **camera,
            **_machine(machine_file),
            **_frames(namespace),
        },
    )


def stored_result(result_file: str, *, publish_tf: bool = True, namespace: str = "") -> NodeSpec:
    """Make the node that publishes a result of `./omm solve --json`, for `result.launch.py`.

    Raises
    ------
    InputError
        The file is missing.
    """
    return NodeSpec(
        package="omm_estimator",
        executable="stored_result_node",
        name="stored_result",
        namespace=namespace,
        parameters={
            **_resolved(result_file=result_file),
            "publish_tf": publish_tf,
            **_frames(namespace),
        },
    )


def parameter_file(kind: str, chosen: str, known: tuple[str, ...]) -> Path:
    """Return the file behind `camera:=gige`: one of ours, or the user's own.

    Raises
    ------
    InputError
        It is neither.
    """
    if chosen in known:
        share = Path(get_package_share_directory("omm_bringup"))
        return share / "config" / f"{kind}_{chosen}.yaml"
    return _own_file(kind, chosen, f"one of {', '.join(known)},")


def _own_file(kind: str, chosen: str, instead: str) -> Path:
    if Path(chosen).is_file():
        return Path(chosen).resolve()
    raise InputError(f"{kind}: expected {instead} or a parameter file; got {chosen!r}.")
