"""A table from outside is read by the names of its columns, or refused by line and column."""

import pytest

from omm_core.errors import InputError
from omm_core.files.csv_input import read_table
from omm_core.files.outside import Text


def table(text: str):
    return read_table(
        Text(name="t.csv", content=text.encode()), "table", ("name", "x_mm"), each="point"
    )


def test_columns_count_by_name_in_any_order_with_blanks_around_them():
    found = table('x_mm , other, name\n 1.5 , 7, A\n\n2.5,8,"B, left"\n')
    assert [row.text("name") for row in found.rows] == ["A", "B, left"]
    assert [row.number("x_mm") for row in found.rows] == [1.5, 2.5]
    assert found.has("other")
    assert not found.has("other", "more")
    assert found.rows[1].where == "t.csv, line 4"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "column name is missing"),
        ("name;x_mm\nA;1\n", "column name is missing"),
        ("name;x_mm\nA;1,5\n", "separated by semicolons.*decimals with a point"),
        ("name\tx_mm\nA\t1\n", "separated by tabs"),
        ("sep=;\nname;x_mm\nA;1\n", "separated by semicolons"),
        ("A,1.5\n", "first line reads 'A,1.5'; it must name the columns"),
        ("name,x_mm\n", "a line for each point"),
        ("name,x_mm,x_mm\nA,1,2\n", "x_mm more than once"),
        ("name,x_mm\nA,1,5\n", "line 2: expected 2 values, got 3.*point"),
    ],
)
def test_a_table_that_could_be_misread_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        table(text)


@pytest.mark.parametrize("word", ["", "one", "nan", "inf", "1;5"])
def test_what_is_no_finite_number_is_refused_by_line_and_column(word):
    row = table(f"name,x_mm\nA,{word}\n").rows[0]
    with pytest.raises(InputError, match=r"t\.csv, line 2: expected a number for x_mm"):
        row.number("x_mm")


def test_values_after_the_last_column_may_be_empty():
    assert table("name,x_mm\nA,1,,\n").rows[0].number("x_mm") == 1.0
