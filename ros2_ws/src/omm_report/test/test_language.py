"""The catalogues are complete, and what nodes say in English is known by its key again."""

import ast
import json
import re
from pathlib import Path

import pytest

from omm_core.errors import InputError
from omm_core.words import Words, keyed
from omm_report.language import (
    FOLDER,
    LANGUAGES,
    VERBATIM,
    catalogue,
    number_text,
    placeholders,
    recognise,
    said_of,
    say,
    text,
)

SOURCES = Path(__file__).parents[2]
# The same word in both languages.
SAME = {
    "de": {"age.minutes", "correct.name"}, "es": {"age.minutes", "station.control"},
    "eu": {"age.minutes"},
}  # fmt: skip


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_catalogue_has_every_key_with_the_same_arguments(language: str) -> None:
    words, english = catalogue(language), catalogue("en")
    assert list(words) == sorted(english)
    assert all(template.strip() for template in words.values())
    differing = {k for k in english if placeholders(words[k]) != placeholders(english[k])}
    assert differing == set()


@pytest.mark.parametrize("language", [name for name in LANGUAGES if name != "en"])
def test_nothing_is_left_in_english(language: str) -> None:
    words, english = catalogue(language), catalogue("en")
    same = {k for k, v in words.items() if v == english[k]}
    wordless = {k for k in same if not re.search(r"[A-Za-z]{3}", re.sub(r"\{\w+\}", "", words[k]))}
    assert same - wordless == SAME[language]


def test_a_catalogue_is_kept_sorted_and_says_nothing_twice() -> None:
    for language in LANGUAGES:
        pairs = json.loads(
            (FOLDER / f"{language}.json").read_text(encoding="utf-8"), object_pairs_hook=list
        )
        keys = [key for key, _ in pairs]
        assert keys == sorted(set(keys))


def test_every_key_that_is_used_is_in_the_catalogue_and_every_key_is_used() -> None:
    python = "".join(
        path.read_text()
        for package in ("omm_operator", "omm_report")
        for path in (SOURCES / package / package).rglob("*.py")
    )
    page = "".join(p.read_text() for p in (SOURCES / "omm_operator/omm_operator/page").glob("*.js"))
    used = set(
        re.findall(r'(?:\bt|\bsay|\btext)\(\s*f?[`"\']([a-z_]+\.[a-z_]+)[`"\']', python + page)
    )
    used |= set(re.findall(r'"([a-z_]+\.[a-z_]+)"', python + page)) & set(catalogue("en"))
    prefixes = set(re.findall(r'[`"\']([a-z_]+\.(?:[a-z]+_)?)[{$]', python + page))
    assert used <= set(catalogue("en"))
    unused = {
        key for key in catalogue("en")
        if key not in used and not key.startswith(("said.", "confirm.", "word.", *prefixes))
    }  # fmt: skip
    assert unused == set()


def test_the_page_holds_no_words_of_its_own() -> None:
    """Strings in the page's scripts that a person would read stand in the catalogue."""
    allowed = {"English", "Deutsch", "Español", "Euskara", "LinuxCNC", "Siemens", "Heidenhain",
               "Fanuc", "Fagor", "OPC UA", "Content-Type"}  # fmt: skip
    for path in (SOURCES / "omm_operator/omm_operator/page").glob("*.js"):
        for found in re.findall(r'"([^"\n]*)"', re.sub(r"//.*", "", path.read_text())):
            readable = re.search(r"[A-ZÄÖÜ][a-zäöü]+ [a-z]+|^[A-Z][a-z]{3,}$", found)
            assert readable is None or found in allowed | {"Enter"}, f"{path.name}: {found}"


NODES_SAY = {
    "the spindle moved by 0.123 mm around the image": ("said.moved", {"mm": "0.123"}),
    "γ_s (and with it x, z) (known to 1.2 mm/m only, k = 2): take a second image of target 8 or 122"
    " at least 40 mm away.": (
        "said.second_image",
        {"names": "γ_s (and with it x, z) (known to 1.2 mm/m only, k = 2)",
         "targets": "8 or 122", "mm": "40"},
    ),
    "X is 0.0120 mm away from its command": ("said.off_command", {"off": "X is 0.0120 mm"}),
}  # fmt: skip


@pytest.mark.parametrize("words", NODES_SAY)
def test_what_a_node_says_is_recognised_and_says_the_same_again(words: str) -> None:
    said = recognise(words)
    assert (said.key, dict(said.args)) == NODES_SAY[words]
    assert said.in_language("en") == words


def test_what_is_not_known_is_said_as_it_is() -> None:
    said = recognise("something new: 1.5 or 2 {x}")
    assert said.key == VERBATIM
    for language in LANGUAGES:
        assert said.in_language(language) == "something new: 1.5 or 2 {x}"


def _keyed_in_sources() -> list[tuple[str, ast.Call]]:
    """All places of our packages where something is said with a key."""
    return [
        (f"{path.relative_to(SOURCES)}:{node.lineno}", node)
        for path in sorted(SOURCES.glob("*/omm_*/**/*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "keyed"
    ]


def test_all_that_nodes_and_core_say_is_in_every_catalogue_word_for_word() -> None:
    said = _keyed_in_sources()
    assert len(said) > 50
    for where, call in said:
        assert all(isinstance(a, ast.Constant) for a in call.args), f"{where}: not literal"
        key, english = (a.value for a in call.args if isinstance(a, ast.Constant))
        assert catalogue("en").get(key) == english, f"{where}: {key}"
        given = {keyword.arg for keyword in call.keywords}
        assert given == set(placeholders(english)), f"{where}: {key}"


def test_every_word_of_the_catalogue_for_nodes_is_said_by_one() -> None:
    said = {call.args[0].value for _, call in _keyed_in_sources()}  # type: ignore[attr-defined]
    folded = {"said.then", "said.row"}  # by omm_core.words
    of_nodes = {key for key in catalogue("en") if key.startswith(("said.", "confirm."))}
    assert of_nodes - said - folded == set()


def test_words_with_a_key_are_translated_by_it_and_so_are_words_in_them() -> None:
    why = keyed("said.moved", "the spindle moved by {mm} mm around the image", mm="0.123")
    told = said_of(keyed("said.cannot_leave_out", catalogue("en")["said.cannot_leave_out"],
                         what=why))  # fmt: skip
    assert told.key == "said.cannot_leave_out"
    german = told.in_language("de")
    assert "um 0,123 mm bewegt" in german
    assert "the " not in german
    shown = told.to_json_dict()
    assert shown["args"]["what"]["key"] == "said.moved"
    assert shown["text"] == told.in_language("en")


@pytest.mark.parametrize(
    "words", [Words("of another version", "said.unheard_of", {}), Words("moved", "said.moved", {})]
)
def test_a_key_that_is_not_known_or_lacks_an_argument_shows_the_text(words: Words) -> None:
    for language in LANGUAGES:
        assert said_of(words).in_language(language) == words


def test_numbers_have_the_decimal_sign_of_the_language() -> None:
    assert number_text("x -0.30, 1.5 mm, 8.1.2, v2.", "de") == "x -0,30, 1,5 mm, 8.1.2, v2."
    assert number_text("1.5", "en") == "1.5"
    moved = say("said.moved", mm="0.123")
    assert moved.in_language("es") == "el husillo se movió 0,123 mm en torno a la imagen"
    german = recognise("γ_s: take a second image of target 8 or 122 at least 40 mm away.")
    assert "8 oder 122" in german.in_language("de")


def test_an_unknown_language_is_told() -> None:
    with pytest.raises(InputError, match="language"):
        text("step.measure", "fr")
