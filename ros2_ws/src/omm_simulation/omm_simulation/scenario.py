"""What a simulated cell is made of, read from a scenario file.

A scenario says how cells of its kind are: the part and how roughly it lies there, the camera and
what it sees, the machine and how it moves, the measuring program. `omm_simulation.cell` draws one
cell from it. It is a folder with `scenario.yaml`, and the `part.yaml` and `camera.yaml` that it
names: these two, and nothing else of it, are what the estimator gets.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from omm_core.errors import InputError
from omm_core.files.declared import (
    Reader,
    file,
    integer,
    number,
    part_of,
    read_section,
    text,
    values,
)
from omm_core.files.part import Part, load_part
from omm_core.files.yaml_input import YamlSection, read_yaml
from omm_core.imaging.calibration import CameraCalibration, load_calibration
from omm_simulation.machine_errors import MachineErrors

Number = Annotated[float, number()]
Vector = Annotated[tuple[float, float, float], values(3)]


@dataclass(frozen=True, kw_only=True)
class PartPlacement:
    """Where the part lies: nominal pose in `machine`, and how far (±, uniform) it may be off it."""

    translation_mm: Vector
    translation_range_mm: Vector
    euler_xyz_rad: Vector = (0.0, 0.0, 0.0)
    euler_xyz_range_rad: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A linear axis and its limits (mm, s)."""

    minimum_mm: Number
    maximum_mm: Number
    velocity_mm_per_s: Number
    acceleration_mm_per_s2: Number
    jerk_mm_per_s3: Number


def _axes(section: YamlSection, key: str) -> dict[str, Axis]:
    axes = section.section(key)
    axes.check_keys("X", "Y", "Z")
    return {axis: read_section(Axis, axes.section(axis)) for axis in ("X", "Y", "Z")}


@dataclass(frozen=True, kw_only=True)
class SimulatedMachine:
    """Three linear axes that carry the spindle.

    Attributes
    ----------
    axes : mapping
        X, Y and Z; their positions are where the spindle is in `machine`.
    home_mm : tuple
        Where the axes are before the program starts.
    spindle_euler_xyz_rad : tuple
        R_CNC, the same all the time: (0, 0, 0) is a vertical spindle whose tool points to −Z.
    servo_lag_s : float
        Time constant with which the axes follow their command.
    structure_frequency_hz, structure_damping : float
        The spindle swings behind what the axes' scales see; 0 Hz means it does not.
    position_resolution_mm : float
        Step of the axis positions that the control reports; 0 means none.
    """

    axes: Annotated[Mapping[str, Axis], Reader(_axes)]
    home_mm: Vector
    spindle_euler_xyz_rad: Vector = (0.0, 0.0, 0.0)
    servo_lag_s: Number = 0.02
    structure_frequency_hz: Number = 25.0
    structure_damping: Number = 0.1
    position_resolution_mm: Number = 0.0001


@dataclass(frozen=True, kw_only=True)
class MeasuringProgram:
    """From where each target is photographed.

    Attributes
    ----------
    distance_mm : float
        From the camera to the target, along the spindle axis.
    stereo_base_mm : float
        Between the two images of a target, along the spindle's x.
    offset_mm : tuple
        Where the targets lie off the spindle axis on average, in the spindle's x and y.
    inward_mm : float
        How far the camera stands from each target towards the middle of all of them.
    spread_mm : float
        How far (±, uniform, per axis) a programmed position is off that.
    retract_mm : float
        How far the camera backs off along the spindle axis between targets.
    dwell_s : float
        Rest at each stop before the image is asked for.
    rest_after_s : float
        Rest after the image has been acknowledged, so that the poses after its exposure prove
        that the spindle stood still.
    acknowledge_timeout_s : float
        How long the program waits for the image before it goes on without.
    """

    distance_mm: Number
    stereo_base_mm: Number
    offset_mm: Annotated[tuple[float, float], values(2)]
    inward_mm: Number = 0.0
    spread_mm: Number = 0.0
    retract_mm: Number = 0.0
    dwell_s: Number = 0.3
    rest_after_s: Number = 0.1
    acknowledge_timeout_s: Number = 5.0


@dataclass(frozen=True, kw_only=True)
class SimulatedImaging:
    """How the camera turns light into grey values (DN of 8 bit).

    Attributes
    ----------
    exposure_s : float
        Duration of an exposure; its middle is the image's stamp.
    target_dn, backing_dn : float
        Grey values of the retroreflective film and of the black around it, at the middle of the
        image and at the program's distance.
    background_dn : float
        Mean grey value of the metal there.
    black_dn : float
        Grey value without light.
    background_contrast : float
        Standard deviation of the metal's texture over its mean.
    reflections : int
        Bright ellipses around each target, none of which touches it.
    blur_sigma_px : float
        Of the point spread function, a Gaussian.
    vignetting : float
        Exponent of cos θ in the lens' fall-off of light; 4 is the natural one.
    ring_light_radius_mm : float
        Of the ring light about the lens.
    electrons_per_dn : float
        Photo-electrons per grey value: the photon noise at a grey value g is √(g / this).
    read_noise_dn : float
        Standard deviation of the noise without light.
    """

    exposure_s: Number = 0.008
    target_dn: Number = 195.0
    backing_dn: Number = 5.0
    background_dn: Number = 22.0
    black_dn: Number = 4.0
    background_contrast: Number = 0.35
    reflections: Annotated[int, integer()] = 3
    blur_sigma_px: Number = 0.8
    vignetting: Number = 4.0
    ring_light_radius_mm: Number = 35.0
    electrons_per_dn: Number = 27.0
    read_noise_dn: Number = 1.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Scenario:
    """A kind of cell.

    Attributes
    ----------
    part_file, calibration_file : Path
        What is given to the estimator.
    part, calibration : Part, CameraCalibration
        The same, read.
    backlash_rad : float
        The holder's play: the clamping angle is uniform over ± half of it.
    errors : MachineErrors
        What is not as the files and the control say; none where the scenario has no such section.
    """

    name: Annotated[str, text()]
    description: Annotated[str, text()]
    part_file: Annotated[Path, file()]
    calibration_file: Annotated[Path, file()]
    part: Part
    calibration: CameraCalibration
    placement: Annotated[PartPlacement, part_of(PartPlacement)]
    backlash_rad: Number
    machine: Annotated[SimulatedMachine, part_of(SimulatedMachine)]
    program: Annotated[MeasuringProgram, part_of(MeasuringProgram)]
    imaging: Annotated[SimulatedImaging, part_of(SimulatedImaging)]
    errors: Annotated[MachineErrors, part_of(MachineErrors)] = field(default_factory=MachineErrors)


def scenario_folder() -> Path:
    """Return where the scenarios are: beside the sources, or in the installed share folder."""
    beside_sources = Path(__file__).resolve().parent.parent / "scenarios"
    if beside_sources.is_dir():
        return beside_sources
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("omm_simulation")) / "scenarios"


def scenario_names() -> tuple[str, ...]:
    """Return the scenarios that omm brings along."""
    return tuple(sorted(path.parent.name for path in scenario_folder().glob("*/scenario.yaml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario that omm brings along, by its name, or one of the user's.

    Parameters
    ----------
    name_or_path : str or Path
        A name (`bench`), a scenario's folder, or its file.

    Raises
    ------
    InputError
        There is no such scenario, or one of its files is malformed.
    """
    root = read_yaml(_find(name_or_path), "scenario file", strict=True)
    return read_section(
        Scenario,
        root,
        part=load_part(root.folder / root.text("part_file")),
        calibration=load_calibration(root.folder / root.text("calibration_file")),
    )


def _find(name_or_path: str | Path) -> Path:
    given = Path(name_or_path)
    for path in (scenario_folder() / given / "scenario.yaml", given / "scenario.yaml", given):
        if path.is_file():
            return path
    raise InputError(
        f"Expected a scenario ({', '.join(scenario_names())}), a scenario's folder or its file, "
        f"got '{name_or_path}', which is none of them."
    )
