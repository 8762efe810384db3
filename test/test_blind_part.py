"""A part 200 mm and 2° away from where it was planned is measured without a person."""

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from blind_part import measure_blind

from omm_cnc_bridge.controls.linuxcnc.cell import is_installed

pytestmark = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)


def test_linuxcnc_is_led_to_a_part_that_lies_elsewhere(tmp_path):
    run = measure_blind(tmp_path, seed=1)
    assert run.least_views >= 2
    assert run.images > run.planned  # the look from afar at least
    assert np.abs(run.errors_in_U).max() < 3.0
