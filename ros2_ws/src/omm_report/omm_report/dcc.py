"""Results in the structure of PTB's Digital Calibration Certificate (DCC 3.3), where it fits.

It is no certificate: laboratory, customer and responsible persons, which the schema wants, are not
known and are left out, and a statement says so. Values and uncertainties are in D-SI (si:real).
"""

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any
from xml.etree import ElementTree

from omm_core.session.quantities import THETA
from omm_runs.solving import SolvedRun

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
VERSION = "3.3.0"
_UNITS = {"mm": "\\milli\\metre", "mm/m": "\\radian"}
_COVERAGE, _PROBABILITY = "2", "0.9545"
_NO_CERTIFICATE = (
    "This is no calibration certificate. Laboratory, customer and responsible persons are not"
    " stated. The expanded uncertainty covers 95.45 % of errors, whatever the distribution."
)


def dcc_xml(runs: Sequence[SolvedRun], data: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the XML of runs and of what a report says of them (checksums)."""
    ElementTree.register_namespace("dcc", DCC)
    ElementTree.register_namespace("si", SI)
    root = ElementTree.Element(_dcc("digitalCalibrationCertificate"), schemaVersion=VERSION)
    _administrative(root, runs, data)
    results = _add(root, "measurementResults")
    for solved, told in zip(runs, data, strict=True):
        _measurement(results, solved, told)
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _administrative(
    root: ElementTree.Element, runs: Sequence[SolvedRun], data: Sequence[Mapping[str, Any]]
) -> None:
    administrative = _add(root, "administrativeData")
    software = _add(_add(administrative, "dccSoftware"), "software")
    _named(software, "omm")
    core = _add(administrative, "coreData")
    _add(core, "usedLangCodeISO639_1").text = "en"
    _add(core, "mandatoryLangCodeISO639_1").text = "en"
    checksums = [seal["sha256"] for told in data for seal in told["seals"]]
    _add(core, "uniqueIdentifier").text = "omm-" + "-".join(sha[:16] for sha in checksums)
    stamps = [image.stamp_ns for solved in runs for image in solved.result.images]
    if stamps:
        _add(core, "beginPerformanceDate").text = _date(min(stamps))
        _add(core, "endPerformanceDate").text = _date(max(stamps))
    items = _add(administrative, "items")
    for name in dict.fromkeys(solved.result.part_name for solved in runs):
        _named(_add(items, "item"), name)
    statement = _add(_add(administrative, "statements"), "statement")
    _content(_add(statement, "declaration"), _NO_CERTIFICATE)


def _measurement(results: ElementTree.Element, solved: SolvedRun, told: Mapping[str, Any]) -> None:
    measurement = _add(results, "measurementResult")
    _named(measurement, f"Recording {told['run']}")
    method = _add(_add(measurement, "usedMethods"), "usedMethod")
    _named(
        method, f"Photogrammetric pose of a part in a machine, model {solved.result.solution.model}"
    )
    software = _add(_add(measurement, "usedSoftware"), "software")
    _named(software, "omm")
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
