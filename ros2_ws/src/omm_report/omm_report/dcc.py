"""Results in the structure of PTB's Digital Calibration Certificate (DCC 3.3), where it fits.

It is not a certificate, and a statement says so. Laboratory, customer, responsible persons and
equipment come from report.yaml (`omm_report.about`); what that does not tell is left out, and the
statement names what the schema wants and is missing. Values and U are in D-SI (si:real).
"""

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any
from xml.etree import ElementTree

from omm_core.session.quantities import THETA
from omm_report.about import About, Equipment, Party
from omm_runs.solving import SolvedRun

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
VERSION = "3.3.0"
_UNITS = {"mm": "\\milli\\metre", "mm/m": "\\radian"}
_COVERAGE, _PROBABILITY = "2", "0.9545"
_NO_CERTIFICATE = (
    "This is not a calibration certificate. The expanded uncertainty covers 95.45 % of errors,"
    " whatever the distribution."
)


def dcc_xml(
    runs: Sequence[SolvedRun], data: Sequence[Mapping[str, Any]], about: About | None = None
) -> bytes:
    """Return the XML of runs, of what a report says of them (checksums), and of who measured."""
    ElementTree.register_namespace("dcc", DCC)
    ElementTree.register_namespace("si", SI)
    root = ElementTree.Element(_dcc("digitalCalibrationCertificate"), schemaVersion=VERSION)
    about = about or About()
    _administrative(root, runs, data, about)
    results = _add(root, "measurementResults")
    for solved, told in zip(runs, data, strict=True):
        _measurement(results, solved, told, about)
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _administrative(
    root: ElementTree.Element,
    runs: Sequence[SolvedRun],
    data: Sequence[Mapping[str, Any]],
    about: About,
) -> None:
    administrative = _add(root, "administrativeData")
    software = _add(_add(administrative, "dccSoftware"), "software")
    _named(software, "omm")
    core = _add(administrative, "coreData")
    if about.laboratory is not None and about.laboratory.country:
        _add(core, "countryCodeISO3166_1").text = about.laboratory.country
    _add(core, "usedLangCodeISO639_1").text = "en"
    _add(core, "mandatoryLangCodeISO639_1").text = "en"
    checksums = [seal["sha256"] for told in data for seal in told["seals"]]
    counted = "omm-" + "-".join(sha[:16] for sha in checksums)
    _add(core, "uniqueIdentifier").text = about.number or counted
    if about.order:
        identified = _add(_add(core, "identifications"), "identification")
        _identification(identified, "customer", about.order, "order")
    stamps = [image.stamp_ns for solved in runs for image in solved.result.images]
    if stamps:
        _add(core, "beginPerformanceDate").text = _date(min(stamps))
        _add(core, "endPerformanceDate").text = _date(max(stamps))
    if about.place:
        _add(core, "performanceLocation").text = about.place
    items = _add(administrative, "items")
    for name in dict.fromkeys(solved.result.part_name for solved in runs):
        _equipment(_add(items, "item"), about.part or Equipment(name=name), "manufacturer")
    if about.laboratory is not None:
        _contact(_add(_add(administrative, "calibrationLaboratory"), "contact"), about.laboratory)
    if about.responsible:
        persons = _add(administrative, "respPersons")
        for at, person in enumerate(about.responsible):
            held = _add(persons, "respPerson")
            _named(_add(held, "person"), person.name)
            if person.role:
                _add(held, "role").text = person.role
            _add(held, "mainSigner").text = "true" if at == 0 else "false"
    if about.customer is not None:
        _contact(_add(administrative, "customer"), about.customer)
    statement = _add(_add(administrative, "statements"), "statement")
    _content(_add(statement, "declaration"), " ".join([_NO_CERTIFICATE, *_missing(about)]))


def _missing(about: About) -> list[str]:
    """Return a sentence that names what the schema wants and nobody has stated."""
    country = about.laboratory.country if about.laboratory is not None else None
    told = {
        "laboratory": about.laboratory, "customer": about.customer, "place": about.place,
        "responsible persons": about.responsible, "country of the laboratory": country,
        "identification of the part": about.part and about.part.serial_number,
    }  # fmt: skip
    absent = [name for name, value in told.items() if not value]
    return [f"Not stated: {', '.join(absent)}."] if absent else []


def _contact(contact: ElementTree.Element, party: Party) -> None:
    _named(contact, party.name)
    for name, value in (("eMail", party.email), ("phone", party.phone)):
        if value:
            _add(contact, name).text = value
    location = _add(contact, "location")
    for name, value in (
        ("city", party.city), ("countryCode", party.country), ("postCode", party.post_code),
        ("street", party.street),
    ):  # fmt: skip
        if value:
            _add(location, name).text = value


def _equipment(held: ElementTree.Element, told: Equipment, issuer: str) -> None:
    """Fill in an item or a piece of equipment."""
    _named(held, told.name)
    if told.manufacturer:
        _named(_add(held, "manufacturer"), told.manufacturer)
    if told.model:
        _add(held, "model").text = told.model
    numbers = (("serial number", told.serial_number), ("certificate", told.certificate))
    if any(value for _, value in numbers):
        listed = _add(held, "identifications")
        for name, value in numbers:
            if value:
                by = issuer if name == "serial number" else "other"
                _identification(_add(listed, "identification"), by, value, name)


def _identification(held: ElementTree.Element, issuer: str, value: str, name: str) -> None:
    _add(held, "issuer").text = issuer
    _add(held, "value").text = value
    _named(held, name)


def _measurement(
    results: ElementTree.Element, solved: SolvedRun, told: Mapping[str, Any], about: About
) -> None:
    measurement = _add(results, "measurementResult")
    _named(measurement, f"Recording {told['run']}")
    method = _add(_add(measurement, "usedMethods"), "usedMethod")
    _named(
        method, f"Photogrammetric pose of a part in a machine, model {solved.result.solution.model}"
    )
    software = _add(_add(measurement, "usedSoftware"), "software")
    _named(software, "omm")
    if about.equipment:
        measured_with = _add(measurement, "measuringEquipments")
        for one in about.equipment:
            _equipment(_add(measured_with, "measuringEquipment"), one, "manufacturer")
    conditions = _add(measurement, "influenceConditions")
    seals = {seal["file"]: seal["sha256"] for seal in told["seals"]}
    for name, sha in {**told["files"], **seals}.items():
        condition = _add(conditions, "influenceCondition")
        _named(condition, f"SHA-256 of {name}")
        _content(_add(condition, "description"), sha)
    listed = _add(measurement, "results")
    for frame, statement in (
        ("own", solved.result.solution.own), ("absolute", solved.result.solution.absolute)
    ):  # fmt: skip
        for k, quantity in enumerate(THETA):
            result = _add(listed, "result")
            _named(result, f"{quantity.name}, {frame}")
            held = _add(_add(result, "data"), "quantity")
            real = ElementTree.SubElement(held, _si("real"))
            ElementTree.SubElement(real, _si("value")).text = repr(float(statement.theta[k]))
            ElementTree.SubElement(real, _si("unit")).text = _UNITS[quantity.unit]
            _uncertainty(real, float(statement.expanded_uncertainty[k]))


def _uncertainty(real: ElementTree.Element, expanded: float) -> None:
    univariate = ElementTree.SubElement(real, _si("measurementUncertaintyUnivariate"))
    told = ElementTree.SubElement(univariate, _si("expandedMU"))
    ElementTree.SubElement(told, _si("valueExpandedMU")).text = repr(expanded)
    ElementTree.SubElement(told, _si("coverageFactor")).text = _COVERAGE
    ElementTree.SubElement(told, _si("coverageProbability")).text = _PROBABILITY


def _named(parent: ElementTree.Element, name: str) -> None:
    _content(_add(parent, "name"), name)


def _content(parent: ElementTree.Element, words: str) -> None:
    # XML has no control characters, whatever a file was called.
    plain = "".join(c if c.isprintable() else "_" for c in words)
    ElementTree.SubElement(parent, _dcc("content"), lang="en").text = plain


def _add(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, _dcc(name))


def _dcc(name: str) -> str:
    return f"{{{DCC}}}{name}"


def _si(name: str) -> str:
    return f"{{{SI}}}{name}"


def _date(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, timezone.utc).date().isoformat()
