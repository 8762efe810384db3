"""A middleware that is not installed: told by name, before a node's first import ends it."""

import sys
from pathlib import Path

import pytest
from whole_suite import ROOT

sys.path.insert(0, str(ROOT))

from setup.running import run_executable


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """An environment with one middleware, one node and one command."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "rmw_typesupport"
    programs = tmp_path / "install" / "lib" / "omm_x"
    for folder in (index, programs):
        folder.mkdir(parents=True)
    for file in (index / "rmw_fastrtps_cpp", index / "rmw_implementation", programs / "x_node",
                 programs / "omm"):  # fmt: skip
        file.touch()
    return tmp_path


class Started(Exception):
    """The program would run now."""


@pytest.mark.parametrize(
    ("program", "name", "starts"),
    [
        ("x_node", "rmw_nonsense", False),
        ("x_node", "rmw_implementation", False),
        ("x_node", "rmw_fastrtps_cpp", True),
        ("x_node", "", True),
        ("omm", "rmw_nonsense", True),  # needs no middleware, or says so itself
    ],
)
def test_a_middleware_that_is_not_there_is_told_with_status_2(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    program: str, name: str, starts: bool,
) -> None:  # fmt: skip
    def start(*_: object) -> None:
        raise Started

    monkeypatch.setattr("os.execve", start)
    environment = {"RMW_IMPLEMENTATION": name, "AMENT_PREFIX_PATH": f"/nowhere:{home}"}
    if starts:
        with pytest.raises(Started):
            run_executable(home, ["omm_x", program], environment)
        return
    assert run_executable(home, ["omm_x", program], environment) == 2
    expected = f"omm: RMW_IMPLEMENTATION: expected rmw_fastrtps_cpp (installed here), got {name}."
    assert capsys.readouterr().err.startswith(expected)
