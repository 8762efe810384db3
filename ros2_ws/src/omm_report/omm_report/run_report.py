"""A measurement as a document that cites its recording: same recordings, same bytes.

The document is for people, in their language; `result.json` and `result.dcc.xml` inside it are for
programs, and are the same in every language.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

import numpy as np

from omm_core.alignment.tolerance import Decision
from omm_core.budget.budget import Budget
from omm_core.part_pose.posterior import PoseStatement
from omm_core.session.quantities import THETA, Quantity
from omm_core.words import Words
from omm_report.about import About
from omm_report.dcc import dcc_xml
from omm_report.document import Document
from omm_report.language import number_text, said_of, text
from omm_report.run_evidence import decisions, input_files, seal_words, seals_of
from omm_report.run_picture import run_picture
from omm_runs.solving import SolvedRun

_STATES = {"inside": "inside", "not proven": "not_proven", "outside": "outside"}
_CORNER = re.compile(r"corner x=(\S+) y=(\S+) z=(\S+)")
_CAPABLE = {True: "doc.capable", False: "doc.not_capable"}
_ADVICE = {"good enough": "enough", "measure better first": "measure_better", "correct": "correct"}


def run_report(
    runs: Sequence[SolvedRun],
    language: str = "en",
    *,
    about: About | None = None,
    budget: Budget | None = None,
) -> bytes:
    """Return the PDF of one run, or of several (before and after an alignment), in their order.

    Parameters
    ----------
    language : str
        Of the document; what is attached is the same in every one.
    about : About or None
        Who measured for whom, and with what.
    budget : Budget or None
        Its summary is added.
    """
    return _Report(runs, language, about or About(), budget).to_bytes()


class _Report:
    """One document in one language."""

    def __init__(
        self, runs: Sequence[SolvedRun], language: str, about: About, budget: Budget | None
    ) -> None:
        self._language = language
        self._document = Document(self._say("doc.title"), language=language)
        self._document.paragraph(self._say("doc.made_by"))
        self._add_about(about)
        data = [self._add_run(solved) for solved in runs]
        if len(runs) > 1:
            self._add_comparison(runs, data)
        if budget is not None:
            self._add_budget(budget)
        content = json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n"
        self._document.attach(
            "result.json",
            content.encode(),
            description="The results, as solve --json writes them, with checksums",
            mime_type="application/json",
        )
        self._document.attach(
            "result.dcc.xml",
            dcc_xml(runs, data, about),
            description="The results in the structure of a digital calibration certificate",
            mime_type="text/xml",
        )

    def to_bytes(self) -> bytes:
        """Return the finished file."""
        return self._document.to_bytes()

    def _say(self, key: str, **args: object) -> str:
        return text(key, self._language, **{name: str(value) for name, value in args.items()})

    def _number(self, value: float, decimals: int = 4, sign: str = "") -> str:
        return number_text(f"{value:{sign}.{decimals}f}", self._language)

    def _told(self, words: str) -> str:
        return said_of(words).in_language(self._language)

    def _head(self, *keys: str) -> list[str]:
        return [self._say(f"doc.{key}") for key in keys]

    def _add_about(self, about: About) -> None:
        """Add who measured what for whom, and with what: as the shop has written it."""
        told: list[tuple[str, list[str]]] = [
            ("number", [about.number or ""]),
            ("order", [about.order or ""]),
            ("laboratory", about.laboratory.lines() if about.laboratory else []),
            ("place", [about.place or ""]),
            ("customer", about.customer.lines() if about.customer else []),
            ("part", [about.part.line()] if about.part else []),
            ("equipment", [one.line() for one in about.equipment]),
            ("responsible", [", ".join(filter(None, (p.name, p.role))) for p in about.responsible]),
            ("remark", [about.remark or ""]),
        ]
        rows = [[self._say(f"doc.{key}"), "\n".join(lines)] for key, lines in told if any(lines)]
        if rows:
            self._document.table(rows, widths=(1, 3), heading_row=False)

    def _add_budget(self, budget: Budget) -> None:
        """Add U of the budget's points along machine X Y Z, its shares, and the capability."""
        self._document.heading(self._say("doc.budget"))
        head = [self._say("doc.point"), *(f"U {axis} (mm)" for axis in "XYZ")]
        rows = [
            [self._point(point.name), *(self._number(U) for U in of)]
            for point, of in zip(budget.points, budget.expanded_mm)
        ]
        self._document.table([head, *rows], widths=(2, 1, 1, 1), align="LRRR")
        worst = self._say("doc.worst", point=self._point(budget.points[budget.worst[0]].name))
        shares = sorted(budget.shares().items(), key=lambda share: -share[1])
        self._document.table(
            [[worst, self._say("doc.share")]]
            + [[name, f"{self._number(100.0 * share, 1)} %"] for name, share in shares],
            widths=(2, 1),
            align="LR",
        )
        judged = budget.capability()
        if judged is not None:
            ratios = (f"{axis} {100.0 * v:.1f} %" for axis, v in zip("XYZ", judged.u_over_t))
            tolerance = f"{judged.tolerance_mm:g}"
            said = self._say("doc.capability", T=tolerance, ratios=", ".join(ratios))
            self._document.paragraph(f"{said} {self._say(_CAPABLE[judged.capable])}")

    def _point(self, name: str) -> str:
        """Return a point's name; the box's corners, which omm names, in the reader's language."""
        corner = _CORNER.fullmatch(name)
        if corner is None:
            return name
        return self._say("doc.corner", x=corner[1], y=corner[2], z=corner[3])

    def _add_run(self, solved: SolvedRun) -> dict[str, Any]:
        document, solution = self._document, solved.result.solution
        document.heading(self._say("doc.recording", run=solved.run.name))
        contents = input_files(solved)
        checksums = {name: hashlib.sha256(c).hexdigest() for name, c in contents.items()}
        seals = seals_of(solved.run)
        self._add_identification(solved, checksums, seals)
        document.heading(self._say("doc.own"), level=3)
        self._add_values(solution.own)
        self._add_shares(solved)
        document.heading(self._say("doc.absolute"), level=3)
        if not solution.geometry_declared:
            document.paragraph(self._say("doc.not_declared"))
        self._add_values(solution.absolute)
        uncertainty = [float(U) for U in solution.expanded_uncertainty]
        decided = decisions(solved, uncertainty, contents.get("part.yaml", b""))
        self._add_decisions(decided)
        self._add_remarks(solved)
        self._add_picture(solved)
        return {
            "run": solved.run.name,
            "files": checksums,
            "seals": seals,
            "decisions": [
                {"quantity": f"{q.symbol} ({q.unit})", "state": d.state, "advice": d.advice}
                for q, d in decided
            ],
            "result": solved.result.to_json_dict(),
        }

    def _add_identification(
        self, solved: SolvedRun, checksums: dict[str, str], seals: list[dict[str, str]]
    ) -> None:
        result, solution = solved.result, solved.result.solution
        self._document.paragraph(
            self._say(
                "doc.summary",
                part=result.part_name,
                model=solution.model,
                used=sum(image.used for image in result.images),
                n=len(result.images),
                rms=f"{solution.rms_px:.4f}",
                sigma=f"{solution.sigma0:.3f}",
                dof=solution.degrees_of_freedom,
            )
        )
        stamps = [image.stamp_ns for image in result.images]
        self._document.paragraph(
            self._say("doc.measured", begin=_utc(min(stamps)), end=_utc(max(stamps)))
        )
        files = [[name, sha] for name, sha in checksums.items()]
        recorded = [[seal["file"], seal["sha256"]] for seal in seals]
        head = [self._say("doc.file"), "SHA-256"]
        self._document.table([head, *files, *recorded], widths=(1, 3))
        for seal in seals:
            words = " ".join(said.in_language(self._language) for said in seal_words(seal))
            self._document.paragraph(f"{seal['file']}: {words}")

    def _add_values(self, told: PoseStatement) -> None:
        values = zip(THETA, told.theta, told.expanded_uncertainty)
        rows = [
            [q.symbol, self._number(v * q.scale), self._number(U * q.scale), q.unit]
            for q, v, U in values
        ]
        head = self._head("quantity", "value", "uncertainty", "unit")
        self._document.table([head, *rows], align="LRRL")

    def _add_shares(self, solved: SolvedRun) -> None:
        """Tell which part of each variance comes from what."""
        shares = solved.result.solution.shares
        if shares:
            rows = [
                [self._say(f"share.{source}"), *(f"{self._number(100.0 * s, 1)} %" for s in of)]
                for source, of in shares.items()
            ]
            head = [self._say("doc.share"), *(q.symbol for q in THETA)]
            widths = (2.6, *[1.0] * len(THETA))
            self._document.table([head, *rows], widths=widths, align="LRRRRRRR")

    def _add_decisions(self, decided: Sequence[tuple[Quantity, Decision]]) -> None:
        self._document.heading(self._say("doc.tolerances"), level=3)
        if not decided:
            self._document.paragraph(self._say("doc.no_tolerances"))
            return
        head = self._head("quantity", "deviation", "uncertainty", "tolerance", "decision", "advice")
        rows = [
            [
                f"{q.symbol} ({q.unit})",
                *(
                    self._number(number * q.scale)
                    for number in (d.deviation, d.expanded_uncertainty, d.tolerance)
                ),
                self._say(f"state.{_STATES[d.state]}"),
                self._say(f"doc.{_ADVICE[d.advice]}"),
            ]
            for q, d in decided
        ]
        self._document.table([head, *rows], widths=(1, 1, 1, 1, 1, 1.6), align="LRRRLL")

    def _add_remarks(self, solved: SolvedRun) -> None:
        result, none = solved.result, self._say("doc.no_reason")
        numbers = {image.stamp_ns: n for n, image in enumerate(result.images, start=1)}
        left_out: list[tuple[str, int, Words | None]] = [
            (self._image(numbers, image.stamp_ns), image.stamp_ns, image.reason)
            for image in result.images
            if not image.used
        ] + [
            (self._target(o.target_id, numbers, o.stamp_ns), o.stamp_ns, o.reason)
            for o in result.observations
            if not o.used
        ]
        self._document.heading(self._say("doc.left_out"), level=3)
        if left_out:
            rows = [[what, str(ns), self._told(why) if why else none] for what, ns, why in left_out]
            head = self._head("what", "stamp", "why")
            self._document.table([head, *rows], widths=(1, 2, 4))
        else:
            self._document.paragraph(self._say("doc.nothing"))
        solution = result.solution
        notes = (*solved.notices, *result.findings, *solution.poor, *solution.remarks)
        if notes:
            self._document.heading(self._say("doc.notes"), level=3)
        for words in notes:
            self._document.paragraph(_sentence(self._told(words)))

    def _image(self, numbers: Mapping[int, int], stamp_ns: int) -> str:
        return self._say("measure.image", n=numbers[stamp_ns], of=len(numbers))

    def _target(self, target_id: int, numbers: Mapping[int, int], stamp_ns: int) -> str:
        return f"{self._image(numbers, stamp_ns)}: {self._say('doc.target', n=target_id)}"

    def _add_picture(self, solved: SolvedRun) -> None:
        drawn = run_picture(solved, self._say("measure.image", n="{n}", of="{of}"), columns=3)
        if drawn is not None:
            pixels, times = np.ascontiguousarray(drawn[0][:, :, ::-1]), f"{drawn[1]:.0f}"
            self._document.picture(pixels, caption=self._say("doc.picture", times=times))

    def _add_comparison(self, runs: Sequence[SolvedRun], data: Sequence[dict[str, Any]]) -> None:
        self._document.heading(self._say("doc.before_after"))
        first, last = runs[0].result.solution.theta, runs[-1].result.solution.theta
        rows = [
            [
                q.symbol,
                self._number(first[k] * q.scale),
                self._number(last[k] * q.scale),
                self._number((last[k] - first[k]) * q.scale, sign="+"),
                q.unit,
            ]
            for k, q in enumerate(THETA)
        ]
        head = self._head("quantity", "before", "after", "change", "unit")
        self._document.table([head, *rows], align="LRRRL")
        self._add_decisions_of_all(data)

    def _state(self, state: str | None) -> str:
        return "–" if state is None else self._say(f"state.{_STATES[state]}")

    def _add_decisions_of_all(self, data: Sequence[dict[str, Any]]) -> None:
        """Add how each tolerance was decided in each recording, where any was."""
        names = list(dict.fromkeys(d["quantity"] for told in data for d in told["decisions"]))
        if not names:
            return
        by_run = [{d["quantity"]: d["state"] for d in told["decisions"]} for told in data]
        rows = [[name, *(self._state(of.get(name)) for of in by_run)] for name in names]
        self._document.table([[self._say("doc.decision"), *(told["run"] for told in data)], *rows])


def _utc(stamp_ns: int) -> str:
    """Return when something was, to the second, in the order of ISO 8601."""
    at = datetime.fromtimestamp(stamp_ns // 1_000_000_000, timezone.utc)
    return at.strftime("%Y-%m-%d %H:%M:%S")


def _sentence(words: str) -> str:
    """Return words as a sentence: with a capital letter, unless a symbol begins it, and a stop."""
    first = words[:1].upper() if words[:1].isascii() else words[:1]
    return first + words[1:] + ("" if words.endswith((".", "!", "?")) else ".")
