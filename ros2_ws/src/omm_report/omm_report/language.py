"""Words in the languages of those who read them: a key and its arguments, looked up in a catalogue.

A catalogue is ``languages/LANGUAGE.json``: one flat object, the same keys and placeholders in each.
What nodes and the core say carries its key and arguments (`omm_core.words`): see `said_of`. Words
without a key (recordings of earlier versions, answers of ROS's own services) are recognised by
their English template: see `recognise`.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omm_core.errors import InputError
from omm_core.words import Words

LANGUAGES = ("en", "de", "es", "eu")
FOLDER = Path(__file__).with_name("languages")
_DECIMAL_COMMA = frozenset({"de", "es", "eu"})
_PLACEHOLDER = re.compile(r"\{([a-zA-Z_]+)\}")
_DECIMAL = re.compile(r"(?<![\d.])([+-]?\d+)\.(\d+)(?![\d.])")
VERBATIM = "said.verbatim"
_TELLING = 10  # characters of a template by which it is known again; "{first}, {last}" is not


@dataclass(frozen=True, kw_only=True)
class Said:
    """What is to be said: the key of the catalogue and its arguments, which may be said as well."""

    key: str
    args: Mapping[str, str | Said] = field(default_factory=dict)

    def in_language(self, language: str = "en") -> str:
        """Return the words in a language."""
        return text(self.key, language, **self.args)

    def to_json_dict(self) -> dict[str, Any]:
        """Return what a page gets: key, arguments, and the English text for who cannot look up."""
        args = {
            name: value.to_json_dict() if isinstance(value, Said) else value
            for name, value in self.args.items()
        }
        return {"key": self.key, "args": args, "text": self.in_language()}


def say(key: str, **args: object) -> Said:
    """Return something to be said; the arguments as they are to be read (decimal point)."""
    return Said(
        key=key,
        args={n: value if isinstance(value, Said) else str(value) for n, value in args.items()},
    )


def said_of(words: str) -> Said:
    """Return what was said: by its key, where it has one that the catalogues know.

    A key of another version of omm, or one whose arguments are not all there, counts as none.
    """
    if isinstance(words, Words) and words.key:
        template = catalogue("en").get(words.key)
        if template is not None and set(placeholders(template)) <= set(words.args):
            args = {
                n: said_of(value) if isinstance(value, Words) and value.key else str(value)
                for n, value in words.args.items()
            }
            return Said(key=words.key, args=args)
    return recognise(str(words))


@functools.cache
def catalogue(language: str) -> Mapping[str, str]:
    """Return a language's catalogue.

    Raises
    ------
    InputError
        Where there is no such language.
    """
    if language not in LANGUAGES:
        raise InputError(f"Expected one of the languages {', '.join(LANGUAGES)}, got '{language}'.")
    loaded: dict[str, str] = json.loads((FOLDER / f"{language}.json").read_text(encoding="utf-8"))
    return loaded


def text(key: str, language: str = "en", **args: str | Said) -> str:
    """Return the words for a key, with its arguments in place and numbers as the language has them.

    Raises
    ------
    KeyError
        Where the catalogue does not know the key, or an argument is missing.
    """
    template = catalogue(language)[key]
    as_it_is = key == VERBATIM

    def argument(found: re.Match[str]) -> str:
        value = args[found[1]]
        if isinstance(value, Said):
            return value.in_language(language)
        return value if as_it_is else argument_text(value, language)

    return _PLACEHOLDER.sub(argument, template)


def argument_text(words: str, language: str) -> str:
    """Return an argument in a language: the decimal sign, and the words between numbers."""
    if language == "en":
        return words
    for key, english in _words_in_arguments():
        words = re.sub(rf"\b{re.escape(english)}\b", catalogue(language)[key], words)
    return number_text(words, language)


def number_text(words: str, language: str) -> str:
    """Return words with the decimal sign of a language."""
    return _DECIMAL.sub(r"\1,\2", words) if language in _DECIMAL_COMMA else words


@functools.cache
def _words_in_arguments() -> tuple[tuple[str, str], ...]:
    """Return the English words (keys ``word.…``) that arguments may hold, the longest first."""
    entries = [(k, english) for k, english in catalogue("en").items() if k.startswith("word.")]
    return tuple(sorted(entries, key=lambda entry: -len(entry[1])))


def placeholders(template: str) -> list[str]:
    """Return the names of a template's arguments, sorted; one that comes twice, twice."""
    return sorted(_PLACEHOLDER.findall(template))


def recognise(words: str) -> Said:
    """Return key and arguments of what a node said in English; verbatim where it is not known."""
    for key, pattern in _patterns():
        found = pattern.fullmatch(words)
        if found is not None:
            return Said(key=key, args=found.groupdict())
    return Said(key=VERBATIM, args={"text": words})


@functools.cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """Return the templates of what nodes say: first those that begin with the most words."""
    templates = [
        (key, template)
        for key, template in catalogue("en").items()
        if key.startswith("said.") and len(_PLACEHOLDER.sub("", template)) >= _TELLING
    ]
    templates.sort(key=lambda entry: (-_begins(entry[1]), -len(_PLACEHOLDER.sub("", entry[1]))))
    return tuple((key, _pattern(template)) for key, template in templates)


def _begins(template: str) -> int:
    """Return how many characters stand before the first argument."""
    found = _PLACEHOLDER.search(template)
    return len(template) if found is None else found.start()


def _pattern(template: str) -> re.Pattern[str]:
    pieces, at = [], 0
    known: set[str] = set()
    for found in _PLACEHOLDER.finditer(template):
        group = f"(?P={found[1]})" if found[1] in known else f"(?P<{found[1]}>.+?)"
        known.add(found[1])
        pieces += [re.escape(template[at : found.start()]), group]
        at = found.end()
    return re.compile("".join([*pieces, re.escape(template[at:])]), re.DOTALL)
