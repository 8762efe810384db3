"""Words that people read, and that programs translate: English text with its key and arguments.

Whoever says something says it with `keyed`: the English template stands where it is said, the other
languages in the catalogues of `omm_report.language`, under the same key. `Words` are a string, so
that logs, files and the command line show the English; a catalogue looks up the key.

Joining words into a string (an f-string, ``str.join``) loses the key: give words as an argument of
other words, or join them with `sentences`, `listed`.
"""

from __future__ import annotations

import bisect
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_PLACEHOLDER = re.compile(r"\{([a-zA-Z_]+)\}")
_DEEPEST = 8  # words in words; what comes from elsewhere may be nested without end


class Words(str):
    """English text that knows its key in the catalogues and its arguments."""

    key: str
    """Empty where it has none."""
    args: Mapping[str, str]
    """By name; each may be `Words` again."""

    __slots__ = ("args", "key")

    def __new__(cls, text: str = "", key: str = "", args: Mapping[str, str] | None = None) -> Words:
        """Return the text with a key."""
        words = super().__new__(cls, text)
        words.key = key
        words.args = dict(args or {})
        return words

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes the same of."""
        return Words, (str(self), self.key, dict(self.args))


NOTHING = Words()


def keyed(key: str, english: str, **args: object) -> Words:
    """Return words: the English template with its arguments in place, and what they are made of.

    Parameters
    ----------
    key : str
        Of the catalogues.
    english : str
        The template; ``{name}`` stands for an argument.
    args : object
        Text as it is to be read (decimal point), or `Words`.

    Raises
    ------
    KeyError
        Where the template names an argument that is not given.
    """
    told = {name: value if isinstance(value, Words) else str(value) for name, value in args.items()}
    return Words(_PLACEHOLDER.sub(lambda found: told[found[1]], english), key, told)


def verbatim(text: str) -> Words:
    """Return text that nobody translates: names, what another program said."""
    return keyed("said.verbatim", "{text}", text=text)


def of_error(error: Exception) -> Words:
    """Return what an error says; with its key, where it was raised with `Words`."""
    told = error.args[0] if len(error.args) == 1 else None
    return told if isinstance(told, Words) else Words(str(error))


def image_number(stamp_ns: int, run_ns: Sequence[int]) -> Words:
    """Return which image of a run it is, "3 of 8 (its stamp ns)"; a stamp alone says little.

    Parameters
    ----------
    stamp_ns : int
        One of ``run_ns``.
    run_ns : sequence of int
        The stamps of all images of the run, sorted.
    """
    n = bisect.bisect_left(run_ns, stamp_ns) + 1
    return keyed("said.image_number", "{n} of {of} ({ns} ns)", n=n, of=len(run_ns), ns=stamp_ns)


def sentences(words: Iterable[str]) -> Words:
    """Return several things that were said as one: "one; another"."""
    return _folded(list(words), "said.then", "{first}; {second}")


def in_a_row(words: Iterable[str]) -> Words:
    """Return "one, another"."""
    return _folded(list(words), "said.row", "{first}, {second}")


def listed(items: Sequence[object], *, choice: bool = False) -> Words:
    """Return "1, 2 and 3", or "1, 2 or 3" where any of them will do."""
    texts = [item if isinstance(item, Words) else str(item) for item in items]
    if len(texts) < 2:
        return Words(texts[0]) if texts else NOTHING
    first = ", ".join(texts[:-1])
    if choice:
        return keyed("said.or", "{first} or {last}", first=first, last=texts[-1])
    return keyed("said.and", "{first} and {last}", first=first, last=texts[-1])


def beside(words: str) -> str:
    """Return what goes beside the English text in a message: key and arguments as JSON, or ""."""
    if not isinstance(words, Words) or not words.key:
        return ""
    return json.dumps(_json_dict(words), ensure_ascii=False, sort_keys=True)


def with_beside(text: str, said: str) -> Words:
    """Return words from a message: its English text, and what stood beside it.

    What is not as `beside` writes it counts as absent: the text is shown as it is.
    """
    try:
        content = json.loads(said) if said else None
    except (ValueError, RecursionError):
        content = None
    read = _from_json(content, 0)
    return Words(text) if read is None else Words(text, read.key, read.args)


def _json_dict(words: Words) -> dict[str, Any]:
    return {"key": words.key, "args": {n: _json_argument(v) for n, v in words.args.items()}}


def _json_argument(value: str) -> Any:
    if isinstance(value, Words) and value.key:
        return {**_json_dict(value), "text": str(value)}
    return str(value)


def _from_json(content: object, depth: int) -> Words | None:
    if not isinstance(content, dict) or depth > _DEEPEST:
        return None
    key, args, text = content.get("key"), content.get("args"), content.get("text", "")
    if not isinstance(key, str) or not isinstance(args, dict) or not isinstance(text, str):
        return None
    read: dict[str, str] = {}
    for name, value in args.items():
        told = value if isinstance(value, str) else _from_json(value, depth + 1)
        if told is None:
            return None
        read[name] = told
    return Words(text, key, read)


def _folded(words: list[str], key: str, english: str) -> Words:
    if not words:
        return NOTHING
    told = words[0] if isinstance(words[0], Words) else Words(words[0])
    for following in words[1:]:
        told = Words(
            english.format(first=told, second=following), key, {"first": told, "second": following}
        )
    return told
