"""What a report says of who measured what for whom, and with what: ``report.yaml``, optional.

All of it is the shop's own words: it is printed as it is, and stands in the attached XML where the
Digital Calibration Certificate has a place for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from omm_core.errors import InputError
from omm_core.files.declared import Reader, each, file, part_of, read_section, text
from omm_core.files.yaml_input import YamlSection, read_yaml

NAME = "report.yaml"
_LONGEST = 200


def _line() -> Reader:
    """Read a text of one line."""

    def read(section: YamlSection, key: str) -> str:
        told = section.text(key)
        if not told.isprintable() or len(told) > _LONGEST:
            raise InputError(
                f"{section.where}: expected {key} as one line of at most {_LONGEST} characters."
            )
        return told

    return Reader(read, str)


def _country() -> Reader:
    """Read a country's two letters (ISO 3166-1)."""

    def read(section: YamlSection, key: str) -> str:
        told = section.text(key)
        if len(told) != 2 or not (told.isascii() and told.isalpha() and told.isupper()):
            raise InputError(
                f"{section.where}: expected {key} as two capital letters, such as DE, got '{told}'."
            )
        return told

    return Reader(read, str)


@dataclass(frozen=True, kw_only=True)
class Party:
    """A laboratory or a customer."""

    name: Annotated[str, _line()]
    street: Annotated[str | None, _line()] = None
    post_code: Annotated[str | None, _line()] = None
    city: Annotated[str | None, _line()] = None
    country: Annotated[str | None, _country()] = None
    email: Annotated[str | None, _line()] = None
    phone: Annotated[str | None, _line()] = None

    def lines(self) -> list[str]:
        """Return name, address and how to reach it."""
        town = " ".join(word for word in (self.country, self.post_code, self.city) if word)
        told = [self.name, self.street, town, self.email, self.phone]
        return [line for line in told if line]


@dataclass(frozen=True, kw_only=True)
class Person:
    """Somebody who answers for the measurement."""

    name: Annotated[str, _line()]
    role: Annotated[str | None, _line()] = None


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """Something that was measured with: camera, machine, scale bar; or the part itself."""

    name: Annotated[str, _line()]
    manufacturer: Annotated[str | None, _line()] = None
    model: Annotated[str | None, _line()] = None
    serial_number: Annotated[str | None, _line()] = None
    certificate: Annotated[str | None, _line()] = None
    """Number and date of its calibration."""

    def line(self) -> str:
        """Return it in one line."""
        told = (self.name, self.manufacturer, self.model, self.serial_number, self.certificate)
        return ", ".join(word for word in told if word)


@dataclass(frozen=True, kw_only=True)
class About:
    """The file as a whole; everything may be absent."""

    number: Annotated[str | None, _line()] = None
    """Of the report, as the shop counts; else it follows from the recordings' checksums."""
    place: Annotated[str | None, _line()] = None
    order: Annotated[str | None, _line()] = None
    laboratory: Annotated[Party | None, part_of(Party)] = None
    customer: Annotated[Party | None, part_of(Party)] = None
    responsible: Annotated[tuple[Person, ...], each(Person)] = ()
    part: Annotated[Equipment | None, part_of(Equipment)] = None
    equipment: Annotated[tuple[Equipment, ...], each(Equipment)] = ()
    remark: Annotated[str | None, text()] = None
    budget: Annotated[Path | None, file()] = None
    """The budget.yaml whose summary the report carries."""


def load_about(path: Path) -> About:
    """Read report.yaml.

    Raises
    ------
    InputError
        Where it is missing, or a key is bad or not known.
    """
    return read_section(About, read_yaml(path, "report file", strict=True))


def about_of(run: Path, named: Path | None = None) -> About:
    """Return what the named file says, else one that lies beside the run, else nothing."""
    if named is not None:
        return load_about(named)
    beside = (run if run.is_dir() else run.parent) / NAME
    return load_about(beside) if beside.is_file() else About()
