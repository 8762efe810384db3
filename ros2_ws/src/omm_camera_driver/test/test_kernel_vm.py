"""The V4L2 driver and the USB3 Vision link against what the kernel has for that, in a machine."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import kernel_vm


@pytest.mark.timeout(600)
def test_the_drivers_in_a_machine_with_cameras_of_the_kernel() -> None:
    if lacking := kernel_vm.missing():
        pytest.skip(f"the virtual machine needs {lacking}")
    status, console = kernel_vm.run(["-rs"])
    assert status == 0, console
