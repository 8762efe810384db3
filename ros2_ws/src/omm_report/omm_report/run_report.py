"""A measurement as a document that cites its recording: same recordings, same bytes.

The document is for people, in their language; `result.json` and `result.dcc.xml` inside it are for
programs, and are the same in every language.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from omm_core.alignment.tolerance import Decision
from omm_core.part_pose.posterior import PoseStatement
from omm_core.session.quantities import THETA, Quantity
from omm_core.words import Words
from omm_report.dcc import dcc_xml
from omm_report.document import Document
from omm_report.language import number_text, said_of, text
from omm_report.run_evidence import decisions, input_files, seal_words, seals_of
from omm_report.run_picture import save_run_picture
from omm_runs.solving import SolvedRun

_STATES = {"inside": "inside", "not proven": "not_proven", "outside": "outside"}
_ADVICE = {"good enough": "enough", "measure better first": "measure_better", "correct": "correct"}


def run_report(runs: Sequence[SolvedRun], language: str = "en") -> bytes:
    """Return the PDF of one run, or of several (before and after an alignment), in their order."""
    return _Report(runs, language).to_bytes()


class _Report:
    """One document in one language."""

    def __init__(self, runs: Sequence[SolvedRun], language: str) -> None:
        self._language = language
        self._document = Document(self._say("doc.title"), language=language)
        self._document.paragraph(self._say("doc.made_by"))
        data = [self._add_run(solved) for solved in runs]
        if len(runs) > 1:
            self._add_comparison(runs)
        content = json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n"
        self._document.attach(
            "result.json",
            content.encode(),
            description="The results, as solve --json writes them, with checksums",
            mime_type="application/json",
        )
        self._document.attach(
            "result.dcc.xml",
            dcc_xml(runs, data),
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
        self._document.table([self._head("quantity", "value", "uncertainty", "unit"), *rows])

    def _add_shares(self, solved: SolvedRun) -> None:
        """Tell which part of each variance comes from what."""
        shares = solved.result.solution.shares
        if shares:
            rows = [
                [self._say(f"share.{source}"), *(f"{self._number(100.0 * s, 1)} %" for s in of)]
                for source, of in shares.items()
            ]
            self._document.table([[self._say("doc.share"), *(q.symbol for q in THETA)], *rows])

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
        self._document.table([head, *rows])

    def _add_remarks(self, solved: SolvedRun) -> None:
        result, none = solved.result, self._say("doc.no_reason")
        left_out: list[tuple[str, str, Words | None]] = [
            (self._say("measure.image", n=number), str(image.stamp_ns), image.reason)
            for number, image in enumerate(result.images, start=1)
            if not image.used
        ] + [
            (self._say("doc.target", n=o.target_id), str(o.stamp_ns), o.reason)
            for o in result.observations
            if not o.used
        ]
        self._document.heading(self._say("doc.left_out"), level=3)
        if left_out:
            rows = [
                [what, stamp, self._told(why) if why else none] for what, stamp, why in left_out
            ]
            head = self._head("what", "stamp", "why")
            self._document.table([head, *rows], widths=(1, 2, 4))
        else:
            self._document.paragraph(self._say("doc.nothing"))
        solution = result.solution
        for words in (*solved.notices, *solution.remarks, *result.findings, *solution.poor):
            self._document.paragraph(self._told(words))

    def _add_picture(self, solved: SolvedRun) -> None:
        with TemporaryDirectory() as folder:
            picture = cv2.imread(str(save_run_picture(solved, Path(folder) / "run.png")))
        if picture is not None:
            pixels = np.asarray(picture[:, :, ::-1], dtype=np.uint8)
            self._document.picture(pixels, caption=self._say("doc.picture"))

    def _add_comparison(self, runs: Sequence[SolvedRun]) -> None:
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
        self._document.table([head, *rows])
