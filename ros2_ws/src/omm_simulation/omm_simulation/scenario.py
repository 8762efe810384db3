"""What a simulated cell is made of, read from a scenario file.

A scenario says how cells of its kind are: the part and how roughly it lies there, the camera and
what it sees, the machine and how it moves, the measuring program. `omm_simulation.cell` draws one
cell from it. It is a folder with `scenario.yaml`, and the `part.yaml` and `camera.yaml` that it
names: these two, and nothing else of it, are what the estimator gets.
"""

import dataclasses
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from omm_core.errors import InputError
from omm_core.files.part import Part, load_part
from omm_core.files.yaml_input import YamlSection, read_yaml
from omm_core.imaging.calibration import CameraCalibration, load_calibration
from omm_simulation.machine_errors import MachineErrors

Vector = tuple[float, float, float]
_T = TypeVar("_T")


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

    minimum_mm: float
    maximum_mm: float
    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    jerk_mm_per_s3: float


@dataclass(frozen=True, kw_only=True)
class Machine:
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

    axes: Mapping[str, Axis]
    home_mm: Vector
    spindle_euler_xyz_rad: Vector = (0.0, 0.0, 0.0)
    servo_lag_s: float = 0.02
    structure_frequency_hz: float = 25.0
    structure_damping: float = 0.1
    position_resolution_mm: float = 0.0001


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

    distance_mm: float
    stereo_base_mm: float
    offset_mm: tuple[float, float]
    inward_mm: float = 0.0
    spread_mm: float = 0.0
    retract_mm: float = 0.0
    dwell_s: float = 0.3
    rest_after_s: float = 0.1
    acknowledge_timeout_s: float = 5.0


@dataclass(frozen=True, kw_only=True)
class Imaging:
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

    exposure_s: float = 0.008
    target_dn: float = 195.0
    backing_dn: float = 5.0
    background_dn: float = 22.0
    black_dn: float = 4.0
    background_contrast: float = 0.35
    reflections: int = 3
    blur_sigma_px: float = 0.8
    vignetting: float = 4.0
    ring_light_radius_mm: float = 35.0
    electrons_per_dn: float = 27.0
    read_noise_dn: float = 1.2


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

    name: str
    description: str
    part_file: Path
    calibration_file: Path
    part: Part
    calibration: CameraCalibration
    placement: PartPlacement
    backlash_rad: float
    machine: Machine
    program: MeasuringProgram
    imaging: Imaging
    errors: MachineErrors = field(default_factory=MachineErrors)


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
    path = _find(name_or_path)
    root = read_yaml(path, "scenario file")
    root.refuse_unknown(*_KEYS, *_SECTIONS)
    part_file = path.parent / root.text("part_file")
    calibration_file = path.parent / root.text("calibration_file")
    sections = {
        name: _read(cls, root.section(name))
        for name, cls in _SECTIONS.items()
        if name != "errors" or name in root
    }
    return Scenario(
        name=root.text("name"),
        description=root.text("description"),
        part_file=part_file,
        calibration_file=calibration_file,
        part=load_part(part_file),
        calibration=load_calibration(calibration_file),
        backlash_rad=root.number("backlash_rad"),
        **sections,
    )


_KEYS = ("name", "description", "part_file", "calibration_file", "backlash_rad")
_SECTIONS: dict[str, Any] = {
    "placement": PartPlacement,
    "machine": Machine,
    "program": MeasuringProgram,
    "imaging": Imaging,
    "errors": MachineErrors,
}


def _find(name_or_path: str | Path) -> Path:
    given = Path(name_or_path)
    for path in (scenario_folder() / given / "scenario.yaml", given / "scenario.yaml", given):
        if path.is_file():
            return path
    raise InputError(
        f"Expected a scenario ({', '.join(scenario_names())}), a scenario's folder or its file, "
        f"got '{name_or_path}', which is none of them."
    )


def _read(cls: type[_T], section: YamlSection) -> _T:
    """Make one of the dataclasses above from the section that describes it."""
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(str(key) for key in section.values if key not in fields)
    if unknown:
        raise InputError(
            f"{section.where}: expected only {', '.join(fields)}, got {', '.join(unknown)}."
        )
    hints = typing.get_type_hints(cls)
    return cls(
        **{
            name: _value(hints[name], section, name)
            for name, f in fields.items()
            if name in section or f.default is dataclasses.MISSING
        }
    )


def _value(hint: Any, section: YamlSection, name: str) -> Any:
    if hint is float:
        return section.number(name)
    if hint is bool:
        return _truth_value(section, name)
    if hint is int:
        return section.integer(name)
    if typing.get_origin(hint) is tuple:
        count = len(typing.get_args(hint))
        return tuple(float(number) for number in section.numbers(name, count))
    axes = section.section(name)
    return {axis: _read(Axis, axes.section(axis)) for axis in ("X", "Y", "Z")}


def _truth_value(section: YamlSection, name: str) -> bool:
    value = section.get(name)
    if not isinstance(value, bool):
        raise InputError(f"{section.where}: expected '{name}' true or false, got {value!r}.")
    return value
