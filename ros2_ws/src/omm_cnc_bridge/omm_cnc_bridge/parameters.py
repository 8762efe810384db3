"""All parameters of the node ``cnc_bridge``."""

from dataclasses import dataclass

from omm_ros.parameters import network_parameter, parameter

CONTROLS = ("simulated", "linuxcnc", "opcua", "mtconnect")
REPORTED = ("axes", "tool_point", "tool_point_on_part")


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """See docs/cnc_controls.md; `./omm machine show` checks a machine file."""

    control: str = parameter("simulated", "Kind of control.", choices=CONTROLS)
    machine_file: str = parameter(
        "",
        "URDF of the machine, or a machine.yaml that names it; may be left out with the simulated "
        "control, which knows its own.",
    )
    reported: str = parameter(
        "axes",
        "What the control's positions are: those of its axes, or (RTCP) X, Y, Z of the tool point "
        "in the standing machine or in coordinates that turn with the table.",
        choices=REPORTED,
    )
    tool_length_mm: float = parameter(
        0.0, "From the spindle's origin to the tool point, where the control reports that."
    )
    allow_commands: bool = parameter(
        False,
        "Whether the bridge may have a real control start programs and carry out blocks (MDI). "
        "It otherwise only reads.",
    )
    mdi_timeout_s: float = parameter(
        60.0,
        "How long to wait for a block (MDI); after that it goes on, but is not waited for.",
        minimum=0.1,
    )

    tolerance_mm: float = parameter(
        0.005, "Largest |command - actual| and motion of a linear axis at rest.", minimum=1e-6
    )
    tolerance_rad: float = parameter(5e-6, "The same for a rotary axis.", minimum=1e-9)
    dwell_s: float = parameter(
        0.2,
        "How long nothing may have moved before the spindle counts as in position.",
        minimum=0.0,
    )
    gap_s: float = parameter(
        0.1, "Samples further apart prove nothing about the time between.", minimum=0.001
    )
    stale_after_s: float = parameter(
        0.3, "Silence after which the control counts as lost.", minimum=0.01
    )
    max_age_s: float = parameter(
        0.5, "Samples that are older than this when they arrive are refused.", minimum=0.001
    )
    max_stamp_uncertainty_s: float = parameter(
        0.01, "Samples whose stamp is less certain (standard deviation) are refused.", minimum=0.0
    )
    reconnect_s: float = parameter(1.0, "Pause between two attempts to connect.", minimum=0.01)

    rate_hz: float = parameter(
        100.0, "Samples per second that the control is asked for.", minimum=10.0, maximum=1000.0
    )
    state_rate_hz: float = parameter(
        20.0, "cnc/state messages per second; changes are also published at once.", minimum=1.0
    )
    publish_truth: bool = parameter(
        True, "Whether a simulated machine's true poses go to simulation/true_spindle_pose."
    )
    frame_prefix: str = parameter("", "Prefix of every frame's name, for several machines: mill1/.")
    publish_tf: bool = parameter(True, "Whether machine -> spindle goes out on /tf.")

    trigger_service: str = parameter(
        "camera/trigger", "Service that takes an image; empty where others trigger the camera."
    )
    trigger_timeout_s: float = parameter(
        5.0, "How long to wait for the camera's answer.", minimum=0.01
    )
    trigger_attempts: int = parameter(3, "Attempts to take an image for one request.", minimum=1)
    retry_s: float = parameter(0.5, "Pause before an image is tried again.", minimum=0.0)
    hold_after_image_s: float = parameter(
        0.12,
        "How long after the exposure's middle the spindle must still stand (estimator: 0.1 s).",
        minimum=0.0,
    )
    start_program: bool = parameter(
        True, "Simulated control: start its program as soon as the camera streams."
    )

    plan_file: str = parameter(
        "",
        "Plan (JSON of `./omm plan`) whose program is led to a part that lies elsewhere; needs "
        "part_file and calibration_file. Empty leads no program.",
    )
    part_file: str = parameter("", "part.yaml of the plan.")
    calibration_file: str = parameter("", "camera.yaml of the plan.")
    find_timeout_s: float = parameter(
        3.0,
        "How long to wait for the estimator with each image; after that, nothing is corrected.",
        minimum=0.1,
    )

    linuxcnc_reader: tuple[str, ...] = parameter(
        (),
        "LinuxCNC on another machine: command that starts linuxcnc_reader.py there, for instance "
        "[ssh, control, python3, -I, -u, linuxcnc_reader.py]. Empty reads the one here.",
    )
    linuxcnc_joints: tuple[str, ...] = parameter(
        (), "LinuxCNC: axis of each joint; empty takes the letters of its configuration."
    )
    linuxcnc_poll: bool = parameter(
        False, "LinuxCNC: poll its status although its HAL has a sampler."
    )
    linuxcnc_cell: str = parameter(
        "",
        "LinuxCNC: start this configuration with simulated drives, and let it run program_file or "
        "else the scenario's program (for trying, see docs/cnc_controls.md). Empty connects to one "
        "that runs.",
        choices=("", "three_axis_mill"),
    )
    program_file: str = parameter(
        "", "Program that ~/start_program starts where allow_commands is set."
    )

    opcua_url: str = parameter("opc.tcp://127.0.0.1:4840", "OPC UA: address of the server.")
    opcua_mapping_file: str = parameter(
        "", "OPC UA: file that says where the control keeps what; empty takes OPC 40502's names."
    )
    opcua_user: str = parameter("", "OPC UA: user; empty logs in anonymously.")
    opcua_password_file: str = parameter("", "OPC UA: file that holds the user's password.")
    opcua_certificate_file: str = parameter(
        "",
        "OPC UA: our certificate (DER or PEM); empty makes one, ~/.local/share/omm/opcua/omm.der.",
    )
    opcua_private_key_file: str = parameter("", "OPC UA: the certificate's private key (PEM).")
    opcua_server_certificate_file: str = parameter(
        "",
        "OPC UA: the server's certificate; empty takes the one that it offers at first, and no "
        "other later (~/.local/share/omm/opcua/known_servers.json).",
    )
    opcua_allow_unencrypted: bool = parameter(
        False, "OPC UA: use the server's plain endpoint although it offers an encrypted one."
    )
    opcua_allow_password_unencrypted: bool = parameter(
        False, "OPC UA: send user and password over a plain channel, where anybody can read them."
    )

    mtconnect_url: str = parameter("http://127.0.0.1:5000", "MTConnect: address of the agent.")
    mtconnect_device: str = parameter(
        "", "MTConnect: name of the device; may be left out where the agent has one."
    )

    scenario: str = parameter("bench", "Simulated control: scenario, or a scenario file.")
    seed: int = parameter(1, "Simulated control: which cell is drawn from the scenario.")
    clamping_seed: int = parameter(
        -1, "Simulated control: another clamping of the same cell; -1 takes the seed."
    )
    repeat: int = parameter(
        1, "Simulated control: number of the measurement in that clamping.", minimum=1
    )
    bumped_id: int = parameter(-1, "Simulated control: target that was bumped; -1 for none.")
    speed_factor: float = parameter(
        1.0, "Simulated control: how many times as fast the machine moves.", minimum=0.01
    )
    repetitions: int = parameter(
        1, "Simulated control: how often it goes through its stops.", minimum=1
    )
    network: bool = network_parameter()
