"""All parameters of the node ``estimator``."""

from dataclasses import dataclass

from omm_core.files.machine import MachineUncertainty
from omm_core.part_pose import SolveOptions
from omm_core.session.measurement import MeasurementOptions
from omm_core.session.pairing import PairingOptions
from omm_core.targets import DetectionOptions
from omm_ros.parameters import network_parameter, parameter


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """What is measured, and when an image may be used."""

    part_file: str = parameter(
        "", "part.yaml: the targets and where they are on the part; another one begins anew.",
        read_only=False,
    )  # fmt: skip
    calibration_file: str = parameter("", "camera.yaml: the lens, and the camera in the taper.")
    machine_file: str = parameter(
        "", "machine.yaml: how exact the machine is; what it leaves out is estimated.",
    )  # fmt: skip
    model: str = parameter(
        "7d", "7d: the holder's angle is solved too; 6d: it is given.",
        choices=("7d", "6d"), read_only=False,
    )  # fmt: skip
    gamma_s_rad: float = parameter(0.0, "Holder's angle in the 6d model.", read_only=False)
    machine_sigma_mm: float = parameter(
        0.0, "Standard deviation of each axis' position at a stop; 0: estimated from the run.",
        minimum=0.0, read_only=False,
    )  # fmt: skip
    worst_machine_mm: float = parameter(
        0.1,
        "Largest error of a machine's geometry (standard deviation); beyond, images are refused.",
        minimum=0.001, read_only=False,
    )  # fmt: skip
    standstill_tolerance_mm: float = parameter(
        0.005, "How far the poses of a spindle that stands still may differ.", minimum=1e-6
    )
    standstill_tolerance_rad: float = parameter(2e-5, "The same for its orientation.", minimum=1e-9)
    standstill_window_s: float = parameter(
        0.1, "How long before and after an image the spindle must stand still.", minimum=0.001
    )
    standstill_gap_s: float = parameter(
        0.06, "Poses farther apart than this prove nothing about the time between.", minimum=0.001
    )
    polarity: str = parameter(
        "both", "Dots that are brighter or darker than their surroundings.",
        choices=("bright", "dark", "both"),
    )  # fmt: skip
    max_dot_diameter_px: float = parameter(400.0, "Largest diameter of a dot.", minimum=8.0)
    centring: str = parameter(
        "fit", "fit: the most accurate; outline: faster, a fifth to a half less accurate.",
        choices=("fit", "outline"),
    )  # fmt: skip
    left_out_ns: tuple[int, ...] = parameter(
        (), "Stamps (ns) of images that are left out on request; ~/leave_out_image sets it.",
        read_only=False,
    )  # fmt: skip
    part_frame: str = parameter("part", "Name of the part's frame in /tf.")
    network: bool = network_parameter()
    frame_prefix: str = parameter("", "Prefix of every frame's name, for several machines: mill1/.")
    publish_tf: bool = parameter(
        True, "Whether machine -> part, spindle -> taper -> camera go out on /tf and /tf_static."
    )

    def solve_options(self, machine: MachineUncertainty) -> SolveOptions:
        """Return how the core is to solve on a machine of which this is declared."""
        return SolveOptions(
            model=self.model,  # type: ignore[arg-type]
            gamma_s_rad=self.gamma_s_rad,
            stop_sigma_mm=self.machine_sigma_mm or None,
            worst_machine_mm=self.worst_machine_mm,
        ).of_machine(machine)

    def measurement_options(self, machine: MachineUncertainty) -> MeasurementOptions:
        """Return what the core is to use."""
        return MeasurementOptions(
            pairing=PairingOptions(
                window_ns=round(self.standstill_window_s * 1e9),
                gap_ns=round(self.standstill_gap_s * 1e9),
                tolerance_mm=self.standstill_tolerance_mm,
                tolerance_rad=self.standstill_tolerance_rad,
            ),
            solve=self.solve_options(machine),
            detection=DetectionOptions(
                polarity=self.polarity,
                max_diameter_px=self.max_dot_diameter_px,
                centring=self.centring,
            ),
        )
