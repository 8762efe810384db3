"""A simulated GigE Vision camera in the simulated cell, as a process of its own.

The camera node talks to it over the network, as to a real one:

    camera_node --ros-args -p driver:=gige -p device:=127.0.0.1
"""

import sys
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray

from omm_camera_driver.drivers.gige.simulator import GigeSimulator
from omm_camera_driver.drivers.simulated.cell_view import cell_view
from omm_camera_driver.drivers.simulated.true_poses import TruePoses
from omm_ros import qos, topics
from omm_ros.conversions import stamp_ns, transform_from_pose
from omm_ros.diagnostics import OK, WARN, Diagnostics, Health
from omm_ros.node_main import run_node
from omm_ros.parameters import declare, parameter
from omm_ros.published import CountingNode

# Shorter than the protocol's own time-out: while it renders, the camera does not answer.
_POSE_TIMEOUT_S = 0.3


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """What is simulated, and where it is found."""

    address: str = parameter("127.0.0.1", "Address of this computer that the camera answers on.")
    serial: str = parameter("OMM-SIM-1", "Serial number.")
    scenario: str = parameter("bench", "What the cell is made of; a name or a path.")
    seed: int = parameter(1, "Equal seeds make equal cells.", minimum=0)
    clamping_seed: int = parameter(
        -1, "Draws the clamping angle alone; -1 takes the seed.", minimum=-1
    )
    bumped_id: int = parameter(
        -1, "A target that is not where the part file says; -1: none.", minimum=-1
    )


class GigeSimulatorNode(CountingNode):
    """Takes the true poses in, and lets the camera see the cell from there."""

    def __init__(self) -> None:
        super().__init__("gige_simulator")
        wanted = declare(self, Parameters)
        self._poses = TruePoses()
        self._view = cell_view(
            wanted.scenario,
            wanted.seed,
            clamping_seed=wanted.clamping_seed,
            bumped_id=wanted.bumped_id,
        )
        self._view.warm_up()
        self._frame = 0
        self._simulator = GigeSimulator(
            self._render,
            self._view.width_px,
            self._view.height_px,
            address=wanted.address,
            serial=wanted.serial,
            exposure_us=self._view.exposure_ns // 1000,
        )
        self.create_subscription(
            PoseStamped, topics.TRUE_SPINDLE_POSE, self._on_true_pose, qos.POSE
        )
        self._diagnostics = Diagnostics(self, hardware_id=wanted.serial)
        self._diagnostics.add("simulated camera", self._health)
        self.get_logger().info(f"Simulated GigE camera {wanted.serial} at {wanted.address}")

    def destroy_node(self) -> None:
        """Take the camera off the network."""
        self._simulator.close()
        super().destroy_node()

    def _render(self, begin_ns: int, exposure_ns: int, bits: int) -> NDArray[np.generic]:
        """Return what the camera sees; called on its own thread, while the exposure lasts."""
        self._frame += 1
        pose_at = self._poses.during(begin_ns, begin_ns + exposure_ns, _POSE_TIMEOUT_S)
        return self._view.render(
            pose_at, begin_ns + exposure_ns // 2, exposure_ns, frame=self._frame, bits=bits
        )

    def _on_true_pose(self, message: PoseStamped) -> None:
        self._poses.add(stamp_ns(message.header.stamp), transform_from_pose(message.pose))

    def _health(self) -> Health:
        problem = self._simulator.problem
        return Health(
            level=WARN if problem else OK,
            message=problem or "on the network",
            values={"images": self._frame},
        )


def main(args: list[str] | None = None) -> None:
    """Run the simulated camera."""
    # One thread: in rclpy's pool, poses come late.
    sys.exit(run_node(GigeSimulatorNode, args, parameters=Parameters, threads=1))
