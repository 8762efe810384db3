"""What documents say is what the code does."""

import re
from pathlib import Path

from omm_bringup.parameter_tables import NODES, tables

ROOT = Path(__file__).parents[1]


def test_the_tables_of_parameters_are_those_of_the_code() -> None:
    written = (ROOT / "docs" / "parameters.md").read_text()
    assert written == tables(), (
        "write it anew: ./omm exec python -m omm_bringup.parameter_tables > docs/parameters.md"
    )
    assert all(f"## {node}\n" in written for node in NODES)


def test_every_package_says_what_it_is_for() -> None:
    for manifest in sorted((ROOT / "ros2_ws" / "src").glob("*/package.xml")):
        text = (manifest.parent / "README.md").read_text()
        assert text.startswith(f"# {manifest.parent.name}: "), manifest.parent.name
        assert "\nTry it: " in text
        for link in re.findall(r"\]\(([^)#]+)\)", text):
            assert (manifest.parent / link).exists(), link
