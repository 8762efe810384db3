"""Makes the control and the machine that the parameters ask for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from omm_cnc_bridge.control import Control
from omm_cnc_bridge.judgement import Reported
from omm_cnc_bridge.parameters import Parameters
from omm_core.errors import InputError
from omm_core.files.outside import read_text
from omm_core.machine.kinematics import Kinematics

if TYPE_CHECKING:
    from omm_simulation.cell import Cell


def make_control(p: Parameters) -> tuple[Control, Kinematics]:
    """Make the control that the parameters name; connect to nothing yet."""
    if p.control == "simulated":
        return _simulated(p)
    if p.control == "linuxcnc" and p.linuxcnc_cell:
        return _linuxcnc_cell(p)
    if not p.machine_file:
        raise InputError(
            f"Expected the parameter machine_file with control {p.control}, got none: give the "
            "machine's URDF; omm_cnc_bridge's folder machines has examples."
        )
    if p.control == "linuxcnc":
        return _linuxcnc(p), Kinematics.load(p.machine_file)
    if p.control == "opcua":
        return _opcua(p), Kinematics.load(p.machine_file)
    if p.control == "mtconnect":
        return _mtconnect(p), Kinematics.load(p.machine_file)
    raise InputError(f"Expected a known control, got {p.control}.")


def _linuxcnc(p: Parameters) -> Control:
    from omm_cnc_bridge.controls.linuxcnc.control import LinuxCncControl

    return LinuxCncControl(
        rate_hz=p.rate_hz,
        reader=p.linuxcnc_reader,
        joint_names=p.linuxcnc_joints,
        program_file=p.program_file,
        poll=p.linuxcnc_poll,
    )


def _opcua(p: Parameters) -> Control:
    try:
        from omm_cnc_bridge.controls.opcua.control import OpcUaControl
        from omm_cnc_bridge.controls.opcua.corrections import CorrectedOpcUaControl
        from omm_cnc_bridge.controls.opcua.logging_in import Security
        from omm_cnc_bridge.controls.opcua.mapping import load_mapping
    except ImportError as error:
        raise InputError(f"Expected asyncua for OPC UA: pip install asyncua ({error}).") from error
    security = Security(
        user=p.opcua_user,
        password_file=p.opcua_password_file,
        certificate_file=p.opcua_certificate_file,
        private_key_file=p.opcua_private_key_file,
        server_certificate_file=p.opcua_server_certificate_file,
        allow_unencrypted=p.opcua_allow_unencrypted,
        allow_password_unencrypted=p.opcua_allow_password_unencrypted,
    )
    file = p.opcua_mapping_file
    led = bool(file) and load_mapping(Path(file)).correction is not None
    kind = CorrectedOpcUaControl if led else OpcUaControl
    return kind(p.opcua_url, rate_hz=p.rate_hz, mapping_file=file, security=security)


def _mtconnect(p: Parameters) -> Control:
    from omm_cnc_bridge.controls.mtconnect.control import MtConnectControl

    return MtConnectControl(
        p.mtconnect_url,
        rate_hz=p.rate_hz,
        device=p.mtconnect_device,
        tool_point=p.reported != Reported.AXES.value,
    )


def _linuxcnc_cell(p: Parameters) -> tuple[Control, Kinematics]:
    """Make a real LinuxCNC with simulated drives, which runs the scenario's stops."""
    from omm_cnc_bridge.controls.linuxcnc.demo import DemoLinuxCnc
    from omm_cnc_bridge.controls.simulated.control import machine_of
    from omm_core.planning.linuxcnc_program import linuxcnc_program
    from omm_core.planning.pattern import backing_off
    from omm_core.planning.program import ProgramOptions, make_program
    from omm_simulation.erring_spindle import ErringSpindle

    cell = _draw(p)
    machine = machine_of(cell.scenario)
    program = cell.scenario.program
    tool = machine.machine_T_spindle({"X": 0.0, "Y": 0.0, "Z": 0.0}).rotation[:, 2]
    options = ProgramOptions(
        retract_mm=program.retract_mm, dwell_s=program.dwell_s, feed_mm_per_min=30000.0
    )
    stops = backing_off(cell.stops, program.retract_mm * tool)
    text = linuxcnc_program(make_program(machine, stops, options, title=cell.scenario.name))
    if p.program_file:
        text = _text(p.program_file)
    true_pose = ErringSpindle(cell).true_pose
    control = DemoLinuxCnc(p.linuxcnc_cell, text, machine, rate_hz=p.rate_hz, true_pose=true_pose)
    return control, machine


def _text(path: str) -> str:
    text = read_text(path, "program")
    if not text.isascii():
        raise InputError(f"Expected a program in plain letters (ASCII) at {path}.")
    return text


def _simulated(p: Parameters) -> tuple[Control, Kinematics]:
    from omm_cnc_bridge.controls.simulated.control import SimulatedCellControl, machine_of

    cell = _draw(p)
    control = SimulatedCellControl(
        cell, rate_hz=p.rate_hz, speed_factor=p.speed_factor, repetitions=p.repetitions
    )
    own = machine_of(cell.scenario)
    return control, Kinematics.load(p.machine_file) if p.machine_file else own


def _draw(p: Parameters) -> Cell:
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    return draw(
        load_scenario(p.scenario),
        p.seed,
        clamping_seed=None if p.clamping_seed < 0 else p.clamping_seed,
        repeat=p.repeat,
        bumped_id=None if p.bumped_id < 0 else p.bumped_id,
    )
