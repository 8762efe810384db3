"""Tables from outside: CSV with the names of its columns in the first line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.outside import Source, read_text

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of a table that knows where it stands, for messages.

    Attributes
    ----------
    values : mapping
        What stands in each column, without the blanks around it.
    where : str
        File and line.
    """

    values: Mapping[str, str]
    where: str

    def has(self, column: str) -> bool:
        """Tell whether there is a value in a column."""
        return bool(self.values.get(column))

    def text(self, column: str) -> str:
        """Return the text in a column.

        Raises
        ------
        InputError
            Where it is empty.
        """
        if not self.has(column):
            raise InputError(f"{self.where}: expected a {column}, got none.")
        return self.values[column]

    def number(self, column: str, *, least: float = -math.inf) -> float:
        """Return the finite number in a column, not below a limit.

        Raises
        ------
        InputError
            Where it is none.
        """
        word = self.values.get(column, "")
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"{self.where}: expected a number for {column}, got {word[:80]!r}.")
        if value < least:
            raise InputError(f"{self.where}: expected {column} >= {least:g}, got {value:g}.")
        return value

    def numbers(self, columns: Sequence[str]) -> Array:
        """Return the numbers in some columns."""
        return np.array([self.number(column) for column in columns])


@dataclass(frozen=True, kw_only=True)
class Table:
    """The rows of a file, and which columns it has."""

    columns: tuple[str, ...]
    rows: tuple[Row, ...]

    def has(self, *columns: str) -> bool:
        """Tell whether the table has all of these columns."""
        return set(columns) <= set(self.columns)


def read_table(path: Source, what: str, columns: Sequence[str], *, each: str) -> Table:
    """Read a table that has at least some columns, in any order.

    Parameters
    ----------
    path : path or Text
        The file, or its contents.
    what : str
        What it is, for messages ("table of points").
    columns : sequence of str
        Those that must be there.
    each : str
        What one line stands for, for messages ("image").

    Raises
    ------
    InputError
        Where the file cannot be read, lacks a column or any line, names a column twice, or has a
        line with more values than columns: a decimal comma would shift the rest of the line.
    """
    text = read_text(path, what)
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    rows: list[Row] = []
    try:
        names = tuple(name.strip() for name in next(reader, []))
        _check_columns(names, columns, str(path))
        for values in reader:
            if values:
                rows.append(_row(names, values, f"{path}, line {reader.line_num}"))
    except csv.Error as error:
        raise InputError(f"The {what} {path} cannot be read: {error}.") from None
    if not rows:
        raise InputError(f"{path}: expected a line for each {each}, found none.")
    return Table(columns=names, rows=tuple(rows))


def _check_columns(names: tuple[str, ...], wanted: Sequence[str], where: str) -> None:
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InputError(
            f"{where}: expected the columns {','.join(wanted)}; the column {missing[0]} is missing."
            + _advice(names)
        )
    twice = [name for name in names if name and names.count(name) > 1]
    if twice:
        raise InputError(f"{where}: expected each column once, got {twice[0]} more than once.")


def _advice(names: tuple[str, ...]) -> str:
    """Return what to do about a first line as spreadsheets write it where decimals have commas."""
    first = names[0] if names else ""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in first or first == f"sep={separator}":
            return (
                f" The first line is separated by {name}: separate by commas, and write decimals"
                " with a point (in a spreadsheet: save as CSV, language English)."
            )
    return f" The first line reads {','.join(names)[:80]!r}; it must name the columns."


def _row(names: tuple[str, ...], values: list[str], where: str) -> Row:
    told = [value.strip() for value in values]
    if any(told[len(names) :]):
        raise InputError(
            f"{where}: expected {len(names)} values, got {len(told)}. Write decimals with a point,"
            " and texts that hold a comma in quotes."
        )
    return Row(values=dict(zip(names, told)), where=where)
