"""Words are English text that keeps its key and arguments, through messages and processes."""

import json
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omm_core.errors import InputError
from omm_core.words import (
    NOTHING,
    Words,
    beside,
    in_a_row,
    keyed,
    listed,
    of_error,
    sentences,
    with_beside,
)


def _nested() -> Words:
    names = keyed("said.with_it", "{first} (and with it {rest})", first="γ_s", rest="x, z")
    return keyed("said.more", "{names}: take {n} more.", names=names, n=3)


def test_words_are_their_english_text() -> None:
    words = _nested()
    assert words == "γ_s (and with it x, z): take 3 more."
    assert isinstance(words, str)
    assert json.loads(json.dumps([words])) == [str(words)]


def test_words_come_back_from_beside_their_text_with_all_that_they_are_made_of() -> None:
    words = _nested()
    read = with_beside(str(words), beside(words))
    assert (read, read.key, read.args["n"]) == (words, "said.more", "3")
    inner = read.args["names"]
    assert isinstance(inner, Words)
    assert (inner.key, dict(inner.args)) == ("said.with_it", {"first": "γ_s", "rest": "x, z"})
    assert beside(read) == beside(words)


def test_words_survive_another_process() -> None:
    words = pickle.loads(pickle.dumps(_nested()))
    assert beside(words) == beside(_nested())


def test_plain_text_has_nothing_beside_it() -> None:
    assert beside("plain") == beside(NOTHING) == ""
    assert with_beside("plain", "").key == ""


@given(st.text(), st.text())
def test_what_is_not_as_written_counts_as_absent(text: str, said: str) -> None:
    read = with_beside(text, said)
    assert read == text


@pytest.mark.parametrize(
    "said",
    ['{"key": 1, "args": {}}', '{"key": "k", "args": {"a": 1}}', "[]", "null", "[" * 50_000,
     '{"key": "k", "args": ' + '{"a": {"key": "k", "args": ' * 40 + "{}" + "}}" * 40 + "}"],
)  # fmt: skip
def test_malformed_and_endless_keys_count_as_absent(said: str) -> None:
    assert with_beside("text", said).key == ""


def test_an_argument_that_is_not_given_is_an_error_of_the_speaker() -> None:
    with pytest.raises(KeyError):
        keyed("said.moved", "moved by {mm} mm")


def test_an_argument_with_braces_stays_as_it_is() -> None:
    assert keyed("k", "{text}", text="{mm}") == "{mm}"
    assert sentences([Words("{a}"), "{b}"]) == "{a}; {b}"


def test_joined_words_keep_the_keys_of_what_they_join() -> None:
    one, other = keyed("a", "one"), keyed("b", "other")
    joined = sentences([one, other])
    assert joined == "one; other"
    assert [w.key for w in joined.args.values() if isinstance(w, Words)] == ["a", "b"]
    assert sentences([one]).key == "a"
    assert in_a_row([one, other, "third"]) == "one, other, third"
    assert sentences([]) == "" == in_a_row([])


def test_lists_read_as_people_write_them() -> None:
    assert [listed(range(n)) for n in range(4)] == ["", "0", "0 and 1", "0, 1 and 2"]
    assert listed([8, 9, 12], choice=True) == "8, 9 or 12"


def test_an_error_raised_with_words_keeps_their_key() -> None:
    assert of_error(InputError(keyed("said.k", "wrong: {x}", x=1))).key == "said.k"
    plain = of_error(InputError("/tmp/{x}: wrong"))
    assert (plain, plain.key) == ("/tmp/{x}: wrong", "")
    assert str(InputError(keyed("said.k", "wrong"))) == "wrong"
