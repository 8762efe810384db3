"""Makes the control and the machine that the parameters ask for."""

from __future__ import annotations

from omm_cnc_bridge.control import Control
from omm_cnc_bridge.kinematics import Machine
from omm_cnc_bridge.parameters import Parameters
from omm_core.errors import InputError


def make_control(p: Parameters) -> tuple[Control, Machine]:
    """Raises InputError where the parameters do not fit together. Connects to nothing yet."""
    if p.control == "simulated":
        return _simulated(p)
    if not p.machine_file:
        raise InputError(
            f"Expected the parameter machine_file with control {p.control}, got none: give the "
            "machine's URDF; omm_cnc_bridge's folder machines has examples."
        )
    raise InputError(f"Expected a known control, got {p.control}.")


def _simulated(p: Parameters) -> tuple[Control, Machine]:
    from omm_cnc_bridge.simulated import SimulatedCellControl, machine_of
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    scenario = load_scenario(p.scenario)
    cell = draw(
        scenario,
        p.seed,
        clamping_seed=None if p.clamping_seed < 0 else p.clamping_seed,
        bumped_id=None if p.bumped_id < 0 else p.bumped_id,
    )
    control = SimulatedCellControl(
        cell, rate_hz=p.rate_hz, speed_factor=p.speed_factor, repetitions=p.repetitions
    )
    machine = Machine.load(p.machine_file) if p.machine_file else machine_of(scenario)
    return control, machine
