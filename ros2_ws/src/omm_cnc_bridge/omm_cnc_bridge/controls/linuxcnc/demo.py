"""The LinuxCNC of `./omm demo`: started with the connection, ended with it."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from omm_cnc_bridge.controls.linuxcnc.cell import FOLDER_PREFIX, LinuxCncCell, remove_stale_folders
from omm_cnc_bridge.controls.linuxcnc.simulated import SimulatedLinuxCnc
from omm_core.machine.kinematics import Kinematics


class DemoLinuxCnc(SimulatedLinuxCnc):
    """A LinuxCNC that is started with the connection and ended with it, and its program."""

    def __init__(self, configuration: str, program: str, machine: Kinematics, **more: Any) -> None:
        super().__init__(machine, **more)
        self._configuration, self._program = configuration, program
        self._cell: LinuxCncCell | None = None

    def connect(self) -> None:
        """Start LinuxCNC with its simulated drives, and connect to it."""
        self.close()
        remove_stale_folders()
        folder = Path(tempfile.mkdtemp(prefix=f"{FOLDER_PREFIX}{os.getpid()}_"))
        self._cell = LinuxCncCell(self._configuration, folder)
        self._program_file = str(folder / "measure.ngc")
        Path(self._program_file).write_text(self._program)
        self._cell.start()
        self._reader = self._cell.reader
        super().connect()

    @property
    def folder(self) -> Path:
        """Where this LinuxCNC lives while it is connected."""
        assert self._cell is not None
        return self._cell.folder

    def close(self) -> None:
        """Disconnect, and end the LinuxCNC that was started."""
        super().close()
        cell, self._cell = self._cell, None
        if cell is not None:
            cell.stop()
            shutil.rmtree(cell.folder, ignore_errors=True)
