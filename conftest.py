"""In CI nothing may be skipped: what a test needs, `.ci/system_packages` installs.

But a ROS installation with its `ros2` command comes from no package of CI's system.
"""

import os
from pathlib import Path

import pytest

ROS2 = ("test_launch_files",)
"""Tests of the real `ros2` command: where no ROS installation is sourced, they are skipped."""


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Fail a run in which a test was skipped, where the variable OMM_NO_SKIPS is set."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    reports = reporter.stats.get("skipped", []) if reporter else []
    skipped = [r for r in reports if not Path(r.nodeid.partition("::")[0]).name.startswith(ROS2)]
    if os.environ.get("OMM_NO_SKIPS") and skipped and exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line(f"{len(skipped)} skipped, and OMM_NO_SKIPS is set: failed", red=True)


# These depend on the timing of a real device or control on a machine that may be busy: a virtual
# machine that boots, packets of a camera, a servo cycle. Nothing else is tried a second time.
REAL_DEVICES = (
    "test_gige",
    "test_v4l2",
    "test_linuxcnc",
    "test_faults_over_dds",
    "test_measuring_program",
    "test_work_offsets",
    "test_blind_part",
    "test_operators_page",
)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let a test of a real device be tried once more, where the plugin for it is there."""
    if not config.pluginmanager.hasplugin("rerunfailures"):
        return
    for item in items:
        if item.path.stem.startswith(REAL_DEVICES):
            item.add_marker(pytest.mark.flaky(reruns=1))
