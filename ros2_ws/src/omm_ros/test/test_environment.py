"""What keeps ROS 2 from starting is told by name, before ROS 2 is asked."""

import subprocess
import sys

import pytest

pytest.importorskip("ament_index_python", reason="ROS 2 is not there")

from omm_core.errors import InputError
from omm_ros.environment import check_environment

BAD = [
    ("RMW_IMPLEMENTATION", "rmw_nonsense"),
    ("ROS_DOMAIN_ID", "abc"),
    ("ROS_DOMAIN_ID", "-1"),
    ("ROS_DOMAIN_ID", "233"),
    ("ROS_DOMAIN_ID", "1.5"),
    ("ROS_LOG_DIR", "/proc/nowhere"),
    ("ROS_HOME", "/dev/null"),
    ("HOME", "/dev/null"),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_value_that_ros_cannot_use_is_told_with_its_variable(monkeypatch, name, value):
    for other in ("ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=f"^{name}: expected"):
        check_environment()


def test_without_any_folder_for_logs_the_variable_to_set_is_told(monkeypatch):
    for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match=r"^ROS_LOG_DIR: expected .* nor HOME\. Set it"):
        check_environment()


@pytest.mark.parametrize("domain", ["", "0", "77", "232"])
def test_values_that_ros_can_use_pass(monkeypatch, tmp_path, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "new" / "log"))
    check_environment()
    assert (tmp_path / "new" / "log").is_dir()


@pytest.mark.parametrize(
    ("name", "value"), [("ROS_DOMAIN_ID", "abc"), ("ROS_LOG_DIR", "/dev/null")]
)
def test_a_node_says_it_in_one_line_with_status_2(monkeypatch, name, value):
    pytest.importorskip("rclpy", reason="ROS 2 is not there")
    monkeypatch.setenv(name, value)
    program = "from omm_ros.node_main import run_node; exit(run_node(None, [], parameters=object))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"omm: {name}: expected")
    assert len(done.stderr.splitlines()) == 1
