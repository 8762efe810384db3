"""Reads what the kinematics need of a URDF: the tree of links and joints.

Lengths become mm here (URDF has metres). Elements that say nothing about the kinematics (visual,
collision, inertial, transmission, …) may be there and are passed over.
"""

from __future__ import annotations

import copy
import math
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import read_bytes
from omm_core.geometry import rotation_from_euler_xyz_rad

_LARGEST_BYTES = 8 << 20
MM_PER_M = 1000.0
MOVABLE = {"prismatic": False, "revolute": True, "continuous": True}  # whether it turns, by type


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """One joint; ``origin`` maps coordinates of the child link (at zero) to the parent link."""

    name: str
    movable: bool
    rotary: bool
    parent: str
    child: str
    origin: NDArray[np.float64]
    """Homogeneous, (4, 4), mm."""
    axis: NDArray[np.float64]
    """Unit vector in the joint's frame, (3,)."""
    lower: float
    """mm or rad; -inf where unlimited."""
    upper: float


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A URDF's tree."""

    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]

    def chain(self, link: str) -> tuple[Joint, ...]:
        """Return the joints from the root to a link; raise InputError if there is no such link."""
        if link not in self.links:
            raise InputError(
                f"Expected a link named {link} in the URDF of {self.name}, got "
                f"{', '.join(self.links)}. Give that name to the link that the tool holder sits in."
            )
        above = {joint.child: joint for joint in self.joints}
        chain: list[Joint] = []
        while link in above:
            chain.append(above[link])
            link = above[link].parent
        return tuple(reversed(chain))


def load_urdf(path: Path) -> Robot:
    """Read a URDF file. Raises InputError, naming file and element, where it is not one."""
    try:
        root = ET.fromstring(read_bytes(path, "machine's URDF", _LARGEST_BYTES))
        if _is_xacro(root):
            root = ET.fromstring(expand_xacro(path))
        return parse_urdf(root)
    # The last two: an encoding that Python does not know.
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"Expected XML in {path}, got an error: {error}.") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _is_xacro(root: ET.Element) -> bool:
    """Return whether elements or attributes are still xacro's (comments may mention it)."""
    return any(
        "xacro" in str(e.tag) or any("${" in v or "$(" in v for v in e.attrib.values())
        for e in root.iter()
    )


def expand_xacro(path: Path) -> str:
    """Run xacro. Raises InputError where it is not installed or refuses the file."""
    program = shutil.which("xacro")
    if program is None:
        raise InputError(
            "Expected a URDF, got a xacro file (it has ${...} or xacro: elements), and xacro is "
            f"not installed here. Expand it where it is: xacro {path.name} > machine.urdf."
        )
    done = subprocess.run(
        [program, str(path)], capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )
    if done.returncode != 0:
        last = (done.stderr.strip() or "no reason given").splitlines()[-1]
        raise InputError(f"Expected xacro to expand the file, but it says: {last}")
    return done.stdout


def parse_urdf(root: ET.Element) -> Robot:
    """Read a ``robot`` element. Raises InputError where it is not a tree of known joints."""
    root = _without_namespace(root)
    if root.tag != "robot":
        raise InputError(f"Expected the element robot, got {root.tag}. Is xacro still to be run?")
    links = tuple(_attribute(link, "name") for link in root.findall("link"))
    joints = tuple(_joint(element) for element in root.findall("joint"))
    return Robot(
        name=_attribute(root, "name"), root=_root(links, joints), links=links, joints=joints
    )


def _without_namespace(root: ET.Element) -> ET.Element:
    """Return a copy whose elements of the root's own namespace have their plain names."""
    namespace, brace, _ = root.tag.rpartition("}")
    if not brace:
        return root
    plain = copy.deepcopy(root)
    for element in plain.iter():
        if isinstance(element.tag, str):
            element.tag = element.tag.removeprefix(namespace + brace)
    return plain


def _root(links: tuple[str, ...], joints: tuple[Joint, ...]) -> str:
    children = [joint.child for joint in joints]
    unknown = {*children, *(joint.parent for joint in joints)} - set(links)
    if unknown:
        missing = ", ".join(sorted(unknown))
        raise InputError(f"Expected every joint's links to be there, {missing} is not.")
    names = [joint.name for joint in joints]
    for kind, values in (("link", links), ("joint", names), ("child link", children)):
        twice = sorted(value for value, number in Counter(values).items() if number > 1)
        if twice:
            raise InputError(f"Expected every {kind} once, got {', '.join(twice)} more than once.")
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise InputError(f"Expected a tree with one root link, got {', '.join(roots) or 'a loop'}.")
    _refuse_loops(joints, roots[0])
    return roots[0]


def _refuse_loops(joints: tuple[Joint, ...], root: str) -> None:
    """Make sure that every link comes down to the root: a chain is gone up without looking."""
    parents = {joint.child: joint.parent for joint in joints}
    rooted = {root}
    for start in parents:
        way, link = {start}, start
        while link not in rooted:
            link = parents[link]
            if link in way:
                told = ", ".join(sorted(way)[:10])
                raise InputError(f"Expected a tree, but its links go round in a loop: {told}.")
            way.add(link)
        rooted |= way


def _joint(element: ET.Element) -> Joint:
    name, kind = _attribute(element, "name"), _attribute(element, "type")
    if kind != "fixed" and kind not in MOVABLE:
        raise InputError(f"Expected joint {name} to be fixed, {', '.join(MOVABLE)}, got {kind}.")
    if element.find("mimic") is not None:
        raise InputError(
            f"Expected joint {name} to move on its own, got a mimic. A gantry's two drives are one "
            "joint here."
        )
    rotary = MOVABLE.get(kind, False)
    lower, upper = _limits(element, kind, name)
    scale = 1.0 if rotary else MM_PER_M
    return Joint(
        name=name,
        movable=kind in MOVABLE,
        rotary=rotary,
        parent=_attribute(_child(element, "parent"), "link"),
        child=_attribute(_child(element, "child"), "link"),
        origin=_origin(element.find("origin"), name),
        axis=_direction(element, name),
        lower=lower * scale,
        upper=upper * scale,
    )


def _origin(element: ET.Element | None, name: str) -> NDArray[np.float64]:
    matrix = np.eye(4)
    if element is not None:
        matrix[:3, 3] = MM_PER_M * _numbers(element.get("xyz", "0 0 0"), name)
        # URDF's rpy turns about fixed x, y, z: the contract's Euler angles.
        matrix[:3, :3] = rotation_from_euler_xyz_rad(*_numbers(element.get("rpy", "0 0 0"), name))
    return matrix


def _direction(element: ET.Element, name: str) -> NDArray[np.float64]:
    axis = element.find("axis")
    direction = _numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), name)
    length = math.hypot(*direction)  # numpy's would warn where it overflows
    if not 1e-9 < length < math.inf:
        raise InputError(f"Expected the axis of joint {name} to have a direction, got {direction}.")
    return np.asarray(direction / length)


def _limits(element: ET.Element, kind: str, name: str) -> tuple[float, float]:
    limit = element.find("limit")
    if kind in ("fixed", "continuous"):
        return -math.inf, math.inf
    if limit is None:
        raise InputError(
            f"Expected limits of joint {name}, got none. URDF requires them of {kind} joints."
        )
    lower, upper = (_limit(limit, attribute, name) for attribute in ("lower", "upper"))
    if not lower < upper:
        raise InputError(f"Expected lower < upper for joint {name}, got {lower} and {upper}.")
    return lower, upper


def _limit(limit: ET.Element, attribute: str, name: str) -> float:
    text = limit.get(attribute, "0")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        hint = " Decimals have a point." if "," in text else ""
        raise InputError(
            f"Expected a number as {attribute} in the limit of joint {name}, got {text!r}.{hint}"
        )
    return value


def _numbers(text: str, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise InputError(f"Expected three numbers in joint {name}, got {text!r}.")
    return numbers


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    if found is None:
        raise InputError(f"Expected the element {tag} in joint {element.get('name')}.")
    return found


def _attribute(element: ET.Element, name: str) -> str:
    value = element.get(name)
    if not value:
        raise InputError(f"Expected the attribute {name} in the element {element.tag}.")
    return value
