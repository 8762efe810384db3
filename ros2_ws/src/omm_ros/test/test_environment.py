"""What keeps ROS 2 from starting is told by name, before ROS 2 is asked."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("ament_index_python", reason="ROS 2 is not there")

from omm_core.errors import InputError
from omm_ros import transport
from omm_ros.environment import PROFILE_VARIABLES, check_environment

BAD = [
    ("RMW_IMPLEMENTATION", "rmw_nonsense"),
    ("ROS_DOMAIN_ID", "abc"),
    ("ROS_DOMAIN_ID", "-1"),
    ("ROS_DOMAIN_ID", "233"),
    ("ROS_DOMAIN_ID", "1.5"),
    ("ROS_LOG_DIR", "/proc/nowhere"),
    ("ROS_HOME", "/dev/null"),
    ("HOME", "/dev/null"),
    ("ROS_STATIC_PEERS", "a name with blanks"),
    ("ROS_STATIC_PEERS", "127.0.0.1;no body"),
    ("ROS_STATIC_PEERS", "a" * 70),
    ("ROS_AUTOMATIC_DISCOVERY_RANGE", "subnet"),
    ("ROS_LOCALHOST_ONLY", "yes"),
    ("RCUTILS_LOGGING_USE_STDOUT", "true"),
    ("RCUTILS_COLORIZED_OUTPUT", "always"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "/nowhere.xml"),
    ("FASTDDS_DEFAULT_PROFILES_FILE", "/dev/null"),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_value_that_ros_cannot_use_is_told_with_its_variable(monkeypatch, name, value):
    for other in ("ROS_LOG_DIR", "ROS_HOME", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=f"^{name}: [Ee]xpected"):
        check_environment()


@pytest.mark.parametrize(
    "content", ["no XML <", "<mill/>", "<?xml version='1.0' encoding='x'?><dds/>"]
)
def test_a_profile_that_fast_dds_would_pass_over_is_refused(monkeypatch, tmp_path, content):
    """It would go on without: with interfaces that are open to the network."""
    profile = tmp_path / "profile.xml"
    profile.write_text(content)
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    with pytest.raises(InputError, match=r"^FASTRTPS_DEFAULT_PROFILES_FILE: .* unset it"):
        check_environment()


@pytest.mark.parametrize("name", ["fastdds.xml", "fastdds_network.xml"])
def test_our_own_profiles_pass(monkeypatch, name):
    profile = Path(__file__).parents[1] / "config" / name
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    check_environment()


@pytest.mark.parametrize(
    ("name", "value"),
    [("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"), ("ROS_LOCALHOST_ONLY", "1")],
)
def test_peers_that_ros_does_not_ask_are_not_looked_up(monkeypatch, name, value):
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    monkeypatch.setenv("ROS_STATIC_PEERS", "nobody.invalid")
    monkeypatch.setenv(name, value)
    check_environment()


def test_who_sets_discovery_anew_does_not_read_what_was_there(monkeypatch):
    monkeypatch.setenv("ROS_STATIC_PEERS", "nobody.invalid")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNETS")
    check_environment(discovery=False)


def test_a_profile_variable_that_is_empty_does_not_open_the_interfaces(monkeypatch):
    for name in PROFILE_VARIABLES:
        monkeypatch.setenv(name, "")
    transport.prepare([])
    assert {Path(os.environ[name]).name for name in PROFILE_VARIABLES} == {"fastdds.xml"}


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
    ("name", "value"),
    [("ROS_DOMAIN_ID", "abc"), ("ROS_LOG_DIR", "/dev/null"), ("ROS_STATIC_PEERS", "no body")],
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
