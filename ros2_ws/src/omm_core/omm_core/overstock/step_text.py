"""What a STEP file says in words: faces' names and colours, and whether it is an assembly.

The reader of the geometry tells none of it. Entities are read as text (ISO 10303-21); only
references are followed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_STATEMENT = re.compile(r"(?:'(?:[^']|'')*'|[^;'])*;")
_ENTITY = re.compile(r"\s*#(\d+)\s*=\s*([A-Z_0-9]+)\s*\((.*)\)\s*;\s*$", re.DOTALL)
_REFERENCE = re.compile(r"#(\d+)")
_STRING = re.compile(r"'((?:[^']|'')*)'")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_STYLES = ("STYLED_ITEM", "OVER_RIDING_STYLED_ITEM")
_PRESENTATION = (
    *_STYLES,
    "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION",
    "PRESENTATION_LAYER_ASSIGNMENT",
    "INVISIBILITY",
)
_NAMED = {
    "red": "#ff0000", "green": "#00ff00", "blue": "#0000ff", "yellow": "#ffff00",
    "magenta": "#ff00ff", "cyan": "#00ffff", "black": "#000000", "white": "#ffffff",
}  # fmt: skip
_SURFACES = {
    "PLANE": "plane",
    "CYLINDRICAL_SURFACE": "cylinder",
    "CONICAL_SURFACE": "cone",
    "SPHERICAL_SURFACE": "sphere",
    "TOROIDAL_SURFACE": "torus",
}


@dataclass(frozen=True, kw_only=True)
class FaceWords:
    """One face: its kind of surface (as face.py names it), label and colour (#rrggbb)."""

    kind: str
    label: str
    colour: str


@dataclass(frozen=True, kw_only=True)
class StepWords:
    """What a file tells.

    Attributes
    ----------
    faces : tuple
        In the order of its shells.
    placed_parts : int
        Parts placed by an assembly.
    bodies : int
        Solids.
    without_presentation : str
        The file without colours and layers, which would cut its faces into heaps.
    """

    faces: tuple[FaceWords, ...]
    placed_parts: int
    bodies: int
    without_presentation: str


def read_words(text: str) -> StepWords:
    """Read the statements of a STEP file."""
    entities: dict[int, tuple[str, str]] = {}
    kept: list[str] = []
    for found in _STATEMENT.finditer(_COMMENT.sub("", text)):
        entity = _ENTITY.match(found.group())
        if entity:
            entities[int(entity.group(1))] = (entity.group(2), entity.group(3))
        if not entity or entity.group(2) not in _PRESENTATION:
            kept.append(found.group())
    kinds = [kind for kind, _ in entities.values()]
    colours = _colours(entities)
    return StepWords(
        faces=tuple(
            FaceWords(
                kind=_surface(entities, number),
                label=_label(entities[number][1]),
                colour=colours.get(number, ""),
            )
            for number in _in_shells(entities)
        ),
        placed_parts=kinds.count("NEXT_ASSEMBLY_USAGE_OCCURRENCE"),
        bodies=kinds.count("MANIFOLD_SOLID_BREP") + kinds.count("BREP_WITH_VOIDS"),
        without_presentation="".join(kept),
    )


def _in_shells(entities: dict[int, tuple[str, str]]) -> list[int]:
    faces: list[int] = []
    for kind, body in entities.values():
        if kind in ("CLOSED_SHELL", "OPEN_SHELL"):
            numbers = [int(n) for n in _REFERENCE.findall(body)]
            faces += [n for n in numbers if entities.get(n, ("", ""))[0] == "ADVANCED_FACE"]
    return faces


def _surface(entities: dict[int, tuple[str, str]], face: int) -> str:
    """Return the kind of the face's surface: the last of its references."""
    last = int(_REFERENCE.findall(entities[face][1])[-1])
    return _SURFACES.get(entities.get(last, ("", ""))[0], "free")


def _label(body: str) -> str:
    found = _STRING.match(body.strip())
    words = found.group(1).replace("''", "'").strip() if found else ""
    return "" if words.upper() in ("NONE", "FACE", "ADVANCED_FACE") else words


def _colours(entities: dict[int, tuple[str, str]]) -> dict[int, str]:
    colours: dict[int, str] = {}
    for kind, body in entities.values():
        if kind not in _STYLES:
            continue
        numbers = [int(n) for n in _REFERENCE.findall(body)]
        items = numbers[:-1] if kind == "OVER_RIDING_STYLED_ITEM" else numbers
        colour = _colour(entities, items[:-1]) if items else ""
        if colour:
            colours[items[-1]] = colour
    return colours


def _colour(entities: dict[int, tuple[str, str]], start: list[int]) -> str:
    """Follow the references of a style to the first colour."""
    waiting, seen = list(start), set[int]()
    while waiting:
        number = waiting.pop(0)
        if number in seen or number not in entities:
            continue
        seen.add(number)
        kind, body = entities[number]
        if kind == "COLOUR_RGB":
            values = [float(v) for v in _STRING.sub("", body).split(",") if v.strip()]
            return "#" + "".join(f"{round(255 * min(max(v, 0.0), 1.0)):02x}" for v in values[:3])
        if kind.endswith("PRE_DEFINED_COLOUR"):
            return _NAMED.get(_label(body).lower(), "")
        waiting += [int(n) for n in _REFERENCE.findall(body)]
    return ""
