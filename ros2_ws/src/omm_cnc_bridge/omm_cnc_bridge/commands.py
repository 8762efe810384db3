"""What the node may be asked to have the control do: its program, a block (MDI), a work offset.

A control that is real does none of it unless ``allow_commands`` is set.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from omm_interfaces.srv import Mdi, WorkOffset
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from omm_cnc_bridge import control as controls
from omm_cnc_bridge.control import Control, HasOffsets, StartsPrograms, TakesBlocks
from omm_cnc_bridge.parameters import Parameters
from omm_core.errors import DeviceError
from omm_core.words import Words, beside, keyed, of_error
from omm_ros.conversions import MM_PER_M

_ONLY_READS = keyed(
    "said.no_allow", "allow_commands is false: the bridge only reads; start it with true"
)
CONNECT_PATIENCE_S = 15.0  # for a control that is just being started


class Commands:
    """The services ``~/start_program``, ``~/mdi`` and ``~/work_offset``.

    Parameters
    ----------
    trouble : callable
        Why the control is not connected; empty where it is.
    unrest : callable
        Why the machine is not at rest without a program; empty where it is.
    """

    def __init__(
        self,
        node: Node,
        control: Control,
        p: Parameters,
        trouble: Callable[[], Words],
        unrest: Callable[[], Words],
    ) -> None:
        self._control, self._p, self._trouble, self._unrest = control, p, trouble, unrest
        self._context = node.context
        self.started = False
        """Whether the program was started."""
        # Both wait for the control: one at a time, so that a thread is left for everything else.
        group = MutuallyExclusiveCallbackGroup()
        node.create_service(Mdi, "~/mdi", self._on_mdi, callback_group=group)
        node.create_service(WorkOffset, "~/work_offset", self._on_work_offset, callback_group=group)
        if isinstance(control, StartsPrograms):
            node.create_service(
                Trigger, "~/start_program", self._on_start_program, callback_group=group
            )

    @property
    def is_simulated(self) -> bool:
        """Whether nothing real can move: the control's drives are simulated by us."""
        return self._p.control == "simulated" or bool(self._p.linuxcnc_cell)

    def introduction(self) -> str:
        """Return what an operator must know of this bridge; empty where nothing real is there."""
        if self.is_simulated:
            return ""
        if self._p.allow_commands:
            return (
                "allow_commands is true: the bridge may start programs on this control and have "
                "it carry out blocks (MDI)."
            )
        return (
            "The bridge only reads this control (allow_commands is false); it answers the "
            "measuring program's requests for images, and moves or sets nothing else."
        )

    def start_program(self) -> tuple[bool, str]:
        """Return whether the program was started, and why not."""
        control = self._control
        if not (self.is_simulated or self._p.allow_commands):
            return False, keyed(
                "said.no_start", "allow_commands is false: start the program at the control"
            )
        if trouble := self._trouble():
            return False, self._not_connected(trouble)
        if not isinstance(control, StartsPrograms):
            return False, f"control {self._p.control} cannot be told to start programs"
        try:
            control.start_program()
        except DeviceError as error:
            return False, str(error)
        self.started = True
        return True, "started"

    def mdi(self, text: str) -> tuple[bool, str]:
        """Return whether the control has carried out a block, and why not."""
        control = self._control
        if not isinstance(control, TakesBlocks):
            return False, f"control {self._p.control} takes no blocks (MDI); linuxcnc does"
        if not self._p.allow_commands:
            return False, _ONLY_READS
        if not text.strip() or "\n" in text:
            return False, f"expected one block, got {text!r}"
        if trouble := self._trouble():
            return False, self._not_connected(trouble)
        try:
            control.mdi(text, self._p.mdi_timeout_s)
        except DeviceError as error:
            return False, str(error)
        return True, "done"

    def work_offset(self, name: str) -> controls.WorkOffset:
        """Return a work offset. Raises DeviceError where the control does not tell it."""
        if not isinstance(self._control, HasOffsets):
            raise DeviceError(
                keyed(
                    "said.no_offsets_told",
                    "control {control} does not report its offsets",
                    control=self._p.control,
                )
            )
        if trouble := self._trouble():
            raise DeviceError(self._not_connected(trouble))
        return self._control.work_offset(name)

    def set_work_offset(self, offset: controls.WorkOffset) -> controls.WorkOffset:
        """Write a work offset and return what was read back. Raises DeviceError with why not."""
        if not isinstance(self._control, HasOffsets):
            raise DeviceError(
                keyed(
                    "said.no_offsets_taken",
                    "control {control} takes no offsets",
                    control=self._p.control,
                )
            )
        if not (self.is_simulated or self._p.allow_commands):
            raise DeviceError(_ONLY_READS)
        if why := self._trouble():
            raise DeviceError(self._not_connected(why))
        if why := self._unrest():
            raise DeviceError(
                keyed("said.not_at_rest", "the machine is not at rest: {why}", why=why)
            )
        return self._control.set_work_offset(offset, self._p.mdi_timeout_s)

    def _not_connected(self, why: Words) -> Words:
        return keyed(
            "said.not_connected",
            "{control} is not connected: {why}",
            control=self._p.control,
            why=why,
        )

    def _on_work_offset(
        self, request: WorkOffset.Request, response: WorkOffset.Response
    ) -> WorkOffset.Response:
        try:
            read = (
                self.set_work_offset(_offset(request))
                if request.write
                else self.work_offset(request.name)
            )
        except DeviceError as error:
            told = of_error(error)
            response.success, response.message, response.said = False, told, beside(told)
            response.position = response.euler_xyz = np.full(3, np.nan)
            return response
        response.success = True
        response.position = np.asarray(read.xyz_mm) / MM_PER_M
        response.euler_xyz = np.asarray(read.euler_xyz_rad)
        return response

    def _on_start_program(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        deadline_s = time.monotonic() + CONNECT_PATIENCE_S
        while self._trouble() and time.monotonic() < deadline_s and self._context.ok():
            time.sleep(0.05)
        response.success, response.message = self.start_program()
        return response

    def _on_mdi(self, request: Mdi.Request, response: Mdi.Response) -> Mdi.Response:
        response.success, response.message = self.mdi(request.command)
        return response


def _offset(request: WorkOffset.Request) -> controls.WorkOffset:
    x, y, z = (float(value) * MM_PER_M for value in request.position)
    a, b, c = (float(angle) for angle in request.euler_xyz)
    return controls.WorkOffset(name=request.name, xyz_mm=(x, y, z), euler_xyz_rad=(a, b, c))
