"""A part that lies far from where it was planned, measured by LinuxCNC without a person."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from omm_core.geometry import RigidTransform, rotation_from_euler_xyz_rad
from omm_core.planning.linuxcnc_program import linuxcnc_program
from omm_core.planning.plan import Plan
from omm_core.planning.plan_file import program_json
from omm_core.planning.plan_program import plan_program
from omm_runs.planning import PlanRequest, plan_of
from omm_runs.solving import SolveRunOptions, solve_run
from omm_simulation.cell import draw
from omm_simulation.scenario import load_scenario, scenario_folder

SEARCH_MM = 260.0
"""How far targets may lie off: the part's 200 mm, and what 2° make of its size."""
MACHINE = """<robot name="mill">
  <link name="machine"/><link name="a"/><link name="b"/><link name="spindle"/>
  <joint name="X" type="prismatic"><parent link="machine"/><child link="a"/>
    <axis xyz="1 0 0"/><limit lower="-1.5" upper="3.0" effort="0" velocity="0.5"/></joint>
  <joint name="Y" type="prismatic"><parent link="a"/><child link="b"/>
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="2.5" effort="0" velocity="0.5"/></joint>
  <joint name="Z" type="prismatic"><parent link="b"/><child link="spindle"/>
    <axis xyz="0 0 1"/><limit lower="-0.5" upper="2.0" effort="0" velocity="0.5"/></joint>
</robot>
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlindRun:
    """What a measurement of a displaced part came to.

    ``errors_in_U`` are those of θ (α to z) over the expanded uncertainty.
    """

    shift_mm: np.ndarray
    turn_rad: np.ndarray
    images: int
    planned: int
    least_views: int
    errors_in_U: np.ndarray


def displaced_scenario(folder: Path, seed: int, shift_mm: np.ndarray, turn_rad: np.ndarray) -> Path:
    """Write the bench with its part elsewhere, turned about the middle of its targets."""
    bench = load_scenario("bench")
    content = yaml.safe_load((scenario_folder() / "bench" / "scenario.yaml").read_text())
    nominal = RigidTransform.from_euler_xyz_rad(0.0, 0.0, 0.0, bench.placement.translation_mm)
    middle = nominal @ np.mean([target.xyz_mm for target in bench.part.targets], axis=0)
    R = rotation_from_euler_xyz_rad(*turn_rad)
    moved = RigidTransform(rotation=R, translation_mm=middle + shift_mm - R @ middle) @ nominal
    content["placement"] = {
        "translation_mm": [round(float(v), 4) for v in moved.translation_mm],
        "translation_range_mm": [0.0, 0.0, 0.0],
        "euler_xyz_rad": [round(float(v), 7) for v in moved.euler_xyz_rad()],
    }
    for axis in content["machine"]["axes"].values():
        axis["minimum_mm"], axis["maximum_mm"] = -1500.0, 3000.0
    for name in ("part_file", "calibration_file"):
        content[name] = str((scenario_folder() / "bench" / content[name]).resolve())
    (folder / "scenario").mkdir(parents=True)
    (folder / "scenario" / "scenario.yaml").write_text(yaml.safe_dump(content))
    return folder / "scenario"


def planned_program(folder: Path) -> Plan:
    """Write program.ngc and plan.json for the part where it should be."""
    bench = load_scenario("bench")
    (folder / "mill.urdf").write_text(MACHINE)
    x, y, z = bench.placement.translation_mm
    plan = plan_of(
        PlanRequest(
            part_file=bench.part_file,
            calibration_file=bench.calibration_file,
            machine_file=folder / "mill.urdf",
            part_at_mm=(x, y, z),
        )
    )
    program = plan_program(plan, limit_mm=SEARCH_MM, search=True)
    # A machine that is busy with other tests takes its time over each image.
    text = linuxcnc_program(program).replace("M66 P0 L3 Q20", "M66 P0 L3 Q120")
    (folder / "program.ngc").write_text(text)
    content = {**plan.to_json(), "program": program_json(plan, program)}
    (folder / "plan.json").write_text(json.dumps(content))
    return plan


def measure_blind(folder: Path, seed: int) -> BlindRun:
    """Draw a displacement of 200 mm and 2°, measure by LinuxCNC, compare with the truth."""
    from rich.console import Console

    from omm_bringup.cell import simulated_cell
    from omm_bringup.isolation import own_domain
    from omm_bringup.processes import check_alive, running
    from omm_operator import measuring
    from omm_simulation.cell import write_estimator_files

    random = np.random.default_rng(seed)
    shift, turn = (random.normal(size=3) for _ in range(2))
    shift *= 200.0 / np.linalg.norm(shift)
    turn *= np.deg2rad(2.0) / np.linalg.norm(turn)
    scenario = displaced_scenario(folder, seed, shift, turn)
    plan = planned_program(folder)
    cell = draw(load_scenario(scenario), seed)
    run = folder / "run"
    run.mkdir()
    write_estimator_files(cell, run)
    specs = simulated_cell(run, scenario=str(scenario), seed=seed, control="linuxcnc")
    led = {
        "program_file": str(folder / "program.ngc"),
        "plan_file": str(folder / "plan.json"),
        "part_file": str(run / "part.yaml"),
        "calibration_file": str(run / "camera.yaml"),
        "machine_file": str(folder / "mill.urdf"),
        "find_timeout_s": 30.0,
        "trigger_timeout_s": 30.0,
        "trigger_attempts": 20,
    }
    specs = tuple(
        dataclasses.replace(spec, parameters={**spec.parameters, **led})
        if spec.name == "cnc_bridge"
        else spec
        for spec in specs
    )
    measuring._READY_S = 120.0
    with own_domain(), running(specs, folder / "log") as nodes:
        measuring.measure_alone(Console(quiet=True), lambda: check_alive(nodes))
    solved = solve_run(run / "run.mcap", SolveRunOptions())
    result = solved.result.to_json_dict()
    truth = cell.theta_own()
    names = list(result["theta"])[:6]
    U = 2.0 * np.sqrt(np.diag(result["covariance"]))[:6]
    errors = np.array([result["theta"][name] - truth[name] for name in names])
    return BlindRun(
        shift_mm=shift,
        turn_rad=turn,
        images=len(result["images"]),
        planned=len(plan.stops),
        least_views=min(solved.result.images_per_target.values()),
        errors_in_U=errors / U,
    )
