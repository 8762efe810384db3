"""YAML from outside, made into values: bounded, and in no way that people read otherwise.

Refused are keys that stand twice (YAML lets the last win), aliases that stand for more than the
file can mean, deep nesting, and the numbers of YAML 1.1 that are others than they look: 010 (8)
and 1:30 (90).
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from omm_core.errors import InputError

_LARGEST_NODES = 1_000_000
_LARGEST_DEPTH = 50
_MISREAD = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)$")
# What PyYAML raises where an explicit tag (!!int, !!timestamp, …) stands before something else.
_BAD_TAG = (ValueError, IndexError, KeyError, AttributeError, TypeError, OverflowError)


def parse_yaml(text: str | bytes, where: str) -> Any:
    """Return what YAML text stands for.

    Parameters
    ----------
    text : str or bytes
        One document.
    where : str
        What it is, for messages ("The part file part.yaml").

    Raises
    ------
    InputError
        Where it is not YAML, or is refused as said above.
    """
    import yaml

    try:
        _check_size(text, where)
        return yaml.load(text, Loader=_strict_loader())
    except yaml.YAMLError as error:
        raise InputError(f"{where} is not YAML: {' '.join(str(error).split())[:1000]}") from None
    except _BAD_TAG as error:
        raise InputError(
            f"{where} holds a value that cannot be read: {str(error)[:200]}."
        ) from None


def _base() -> Any:
    import yaml

    # The one in C is five times as fast; it lives where libyaml does.
    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _check_size(text: str | bytes, where: str) -> None:
    """Refuse what would be too large or too deep once made; counts, makes nothing."""
    import yaml

    sizes = [0]
    open_anchors: list[str | None] = []
    anchored: dict[str | None, int] = {}
    for event in yaml.parse(text, Loader=_base()):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in open_anchors:
                raise InputError(f"{where}: the alias *{event.anchor} stands for itself.")
            sizes[-1] += anchored.get(event.anchor, 0)
        elif isinstance(event, yaml.ScalarEvent):
            sizes[-1] += 1
            if event.anchor:
                anchored[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            sizes.append(1)
            open_anchors.append(event.anchor)
            if len(sizes) > _LARGEST_DEPTH:
                raise InputError(
                    f"{where} is nested too deeply to be one: more than {_LARGEST_DEPTH} levels."
                )
        elif isinstance(event, yaml.CollectionEndEvent):
            size, anchor = sizes.pop(), open_anchors.pop()
            sizes[-1] += size
            if anchor:
                anchored[anchor] = size
        if sizes[-1] > _LARGEST_NODES:
            raise InputError(
                f"{where} stands for more than {_LARGEST_NODES} values, too many to be one."
                " Are there aliases (*name) in it?"
            )


@cache
def _strict_loader() -> Any:
    import yaml

    class Strict(_base()):  # type: ignore[misc]
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            _refuse_twice(self, node)
            return dict(super().construct_mapping(node, deep))

        def construct_yaml_int(self, node: Any) -> Any:
            _refuse_misread(node)
            return super().construct_yaml_int(node)

        def construct_yaml_float(self, node: Any) -> Any:
            _refuse_misread(node)
            return super().construct_yaml_float(node)

    Strict.add_constructor("tag:yaml.org,2002:int", Strict.construct_yaml_int)
    Strict.add_constructor("tag:yaml.org,2002:float", Strict.construct_yaml_float)
    assert issubclass(Strict, yaml.constructor.SafeConstructor)
    return Strict


def _refuse_twice(loader: Any, node: Any) -> None:
    import yaml

    if not isinstance(node, yaml.MappingNode):
        return  # its own error comes
    lines: dict[Any, int] = {}
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag.endswith(":merge"):
            continue
        name, line = loader.construct_object(key), key.start_mark.line + 1
        if name in lines:
            raise yaml.constructor.ConstructorError(
                None,
                None,
                f"the key '{key.value[:80]}' stands twice, in lines {lines[name]} and {line};"
                " keep one of them",
                key.start_mark,
            )
        lines[name] = line


def _refuse_misread(node: Any) -> None:
    import yaml

    if _MISREAD.match(str(node.value)):
        raise yaml.constructor.ConstructorError(
            None,
            None,
            f"'{node.value[:80]}' is another number in YAML than it looks; write it as a decimal"
            " number without leading zeros, or in quotes where it is a name",
            node.start_mark,
        )
