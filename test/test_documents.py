"""What documents say is what the code does."""

import importlib
import re
from functools import reduce
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


def test_the_functions_of_the_measurement_model_are_where_it_says() -> None:
    text = (ROOT / "docs" / "measurement_model.md").read_text()
    named = re.findall(r"`((?:\w+/)+\w+)\.(\w+(?:\.\w+)*)`", text)
    rooms = [(module, name) for module, name in named if "test/" not in module]
    assert len(rooms) > 8
    for module, name in rooms:
        there = importlib.import_module(f"omm_core.{module.replace('/', '.')}")
        if name != "py":
            reduce(getattr, name.split("."), there)


def test_the_source_files_that_documents_name_are_there() -> None:
    sources = [f"/{path.relative_to(ROOT).as_posix()}" for path in ROOT.glob("[brst]*/**/*.py")]
    examples = ("omm_camera_driver/drivers/folder/driver.py", "commands/COMMAND.py")
    for document in [*ROOT.glob("docs/**/*.md"), *ROOT.glob("ros2_ws/src/*/README.md")]:
        for name in re.findall(r"[`(/ ]((?:\w+/)*[a-z_]\w*\.py)\b", document.read_text()):
            there = any(source.endswith(f"/{name}") for source in sources)
            assert there or name in examples, f"{document.name}: {name}"
