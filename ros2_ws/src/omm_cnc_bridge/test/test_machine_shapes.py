"""The machines that come with omm can be looked at: RViz and Foxglove draw each link."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

MACHINES = sorted((Path(__file__).parents[1] / "machines").glob("*.urdf"))


def numbers(element: ET.Element | None, name: str, default: str) -> np.ndarray:
    return np.array(
        [float(x) for x in (element.get(name, default) if element is not None else default).split()]
    )


def lowest_m(visual: ET.Element) -> float:
    """z of the lowest point of an upright box or cylinder, in its link."""
    origin = visual.find("origin")
    assert not numbers(origin, "rpy", "0 0 0").any()
    box, cylinder = visual.find("geometry/box"), visual.find("geometry/cylinder")
    high = numbers(box, "size", "")[2] if box is not None else numbers(cylinder, "length", "")[0]
    return float(numbers(origin, "xyz", "0 0 0")[2] - high / 2)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda path: path.stem)
def test_every_moving_link_has_a_shape_of_a_colour_that_is_defined(machine: Path) -> None:
    robot = ET.parse(machine).getroot()
    colours = {material.get("name") for material in robot.findall("material")}
    links = {link.get("name"): link for link in robot.findall("link")}
    moving = {
        joint.find("child").get("link")  # type: ignore[union-attr]
        for joint in robot.findall("joint")
        if joint.get("type") != "fixed"
    }
    for name in moving | {"machine"}:
        assert links[name].findall("visual"), name
    used = {m.get("name") for m in robot.findall("link/visual/material")}
    assert used <= colours


@pytest.mark.parametrize("machine", MACHINES, ids=lambda path: path.stem)
def test_nothing_of_the_spindle_is_where_the_tool_holder_goes(machine: Path) -> None:
    robot = ET.parse(machine).getroot()
    (spindle,) = (link for link in robot.findall("link") if link.get("name") == "spindle")
    for visual in spindle.findall("visual"):
        assert lowest_m(visual) >= -1e-9
