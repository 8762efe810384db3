"""What the README tells to type works, and what it links to is there."""

import re
import shlex
from pathlib import Path

import pytest
from whole_suite import ROOT, Omm

from omm_bringup.command_line import COMMANDS

README = (ROOT / "README.md").read_text()
OF_THE_SCRIPT = {"test", "run", "exec", "setup"}  # answered by ./omm itself


def commands_below(heading: str) -> list[list[str]]:
    section = README.split(f"## {heading}\n")[1].split("\n## ")[0]
    return [
        shlex.split(line, comments=True) for line in re.findall(r"^\$ \./omm (.*)$", section, re.M)
    ]


def test_every_command_that_is_shown_exists() -> None:
    shown = {words[0] for words in map(str.split, re.findall(r"\./omm ([a-z]+)", README))}
    assert shown <= set(COMMANDS) | OF_THE_SCRIPT


@pytest.mark.timeout(600)
def test_what_comes_next_works_in_the_order_of_the_readme(omm: Omm) -> None:
    for words in commands_below("What next"):
        omm(*words)


@pytest.mark.parametrize("target", re.findall(r"\]\(([^)#]+)\)", README))
def test_every_link_leads_somewhere(target: str) -> None:
    assert (ROOT / target).exists()


def test_every_command_has_its_module() -> None:
    folder = ROOT / "ros2_ws" / "src" / "omm_bringup" / "omm_bringup" / "commands"
    modules = {path.stem for path in Path(folder).glob("[a-z]*.py")}
    assert modules == set(COMMANDS)
