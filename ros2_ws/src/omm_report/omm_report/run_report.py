"""A measurement as a document that cites its recording: same recordings, same bytes."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from omm_core.alignment.tolerance import Decision, decide
from omm_core.errors import InputError
from omm_core.files.strict_yaml import parse_yaml
from omm_core.part_pose.posterior import PoseStatement
from omm_core.session.quantities import THETA
from omm_recording.reading import Recording
from omm_recording.run_files import find_run
from omm_recording.verifying import verify
from omm_report.document import Document
from omm_report.run_picture import save_run_picture
from omm_runs.solving import SolvedRun

_FILES = (
    ("part.yaml", "part_file"),
    ("camera.yaml", "calibration_file"),
    ("machine.yaml", "machine_file"),
)


def run_report(runs: Sequence[SolvedRun]) -> bytes:
    """Return the PDF of one run, or of several (before and after an alignment), in their order."""
    document = Document("Measurement of a part's pose")
    document.paragraph(
        "Made by omm from the recordings named below. This is no calibration certificate."
    )
    data = [_add_run(document, solved) for solved in runs]
    if len(runs) > 1:
        _add_comparison(document, runs)
    document.attach(
        "result.json",
        (json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n").encode(),
        description="The results, as solve --json writes them, with checksums",
        mime_type="application/json",
    )
    return document.to_bytes()


def _add_run(document: Document, solved: SolvedRun) -> dict[str, Any]:
    result = solved.result
    document.heading(f"Recording {solved.run.name}")
    contents = _input_files(solved)
    checksums = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    rows = [["file", "SHA-256"], *([name, sha] for name, sha in checksums.items())]
    seals = _seals(solved.run)
    document.paragraph(
        f"Part {result.part_name}, model {result.solution.model},"
        f" {sum(image.used for image in result.images)} of {len(result.images)} images used,"
        f" RMS {result.solution.rms_px:.4f} px, sigma0 {result.solution.sigma0:.3f},"
        f" {result.solution.degrees_of_freedom} degrees of freedom."
    )
    document.table([*rows, *([s["file"], s["sha256"]] for s in seals)], widths=(1, 3))
    for seal in seals:
        document.paragraph(f"{seal['file']}: {seal['verdict']}")
    content = result.to_json_dict()
    solution = result.solution
    uncertainty = [float(U) for U in solution.expanded_uncertainty]
    head = ["quantity", "value", "U (95.45 %)", "unit"]
    document.heading("Result, in the machine's own coordinates", level=3)
    document.table([head, *_values(solution.own)])
    _add_shares(document, solved)
    document.heading("The same in an ideal machine frame (absolute)", level=3)
    if not solution.geometry_declared:
        document.paragraph(
            "The machine's geometry is not declared: its errors that are longer than the part are"
            " not in this U."
        )
    document.table([head, *_values(solution.absolute)])
    decisions = _decisions(solved, uncertainty, contents.get("part.yaml", b""))
    document.heading("Tolerances (ISO 14253-1)", level=3)
    if decisions:
        document.table(
            [["quantity", "deviation", "U", "tolerance ±", "decision", "advice"], *decisions]
        )
    else:
        document.paragraph("The part file states no tolerances: nothing is decided.")
    _add_remarks(document, solved)
    with TemporaryDirectory() as folder:
        picture = cv2.imread(str(save_run_picture(solved, Path(folder) / "run.png")))
    if picture is not None:
        document.picture(np.asarray(picture[:, :, ::-1], dtype=np.uint8), caption=_CAPTION)
    return {
        "run": solved.run.name,
        "files": checksums,
        "seals": seals,
        "decisions": [{"quantity": row[0], "state": row[4], "advice": row[5]} for row in decisions],
        "result": content,
    }


_CAPTION = "Images with their targets; residuals enlarged as written below the picture."


def _values(told: PoseStatement) -> list[list[str]]:
    values = zip(THETA, told.theta, told.expanded_uncertainty)
    return [[q.symbol, f"{v * q.scale:.4f}", f"{U * q.scale:.4f}", q.unit] for q, v, U in values]


def _add_shares(document: Document, solved: SolvedRun) -> None:
    """Tell which part of each variance comes from what."""
    shares = solved.result.solution.shares
    if shares:
        rows = [[source, *(f"{100.0 * s:.1f} %" for s in of)] for source, of in shares.items()]
        document.table([["share of the variance", *(q.symbol for q in THETA)], *rows])


def _decisions(solved: SolvedRun, uncertainty: Sequence[float], part: bytes) -> list[list[str]]:
    stated = parse_yaml(part, "The part file") or {}
    tolerances, nominal = stated.get("tolerances") or {}, stated.get("nominal") or {}
    angles = nominal.get("euler_xyz_rad") or [None] * 3
    wanted = [*angles, *(nominal.get("translation_mm") or [None] * 3)]
    rows = []
    for k, quantity in enumerate(THETA[:6]):
        if tolerances.get(quantity.key) is None or wanted[k] is None:
            continue
        deviation = float(solved.result.solution.theta[k]) - float(wanted[k])
        decision = decide(deviation, uncertainty[k], float(tolerances[quantity.key]))
        rows.append([f"{quantity.symbol} ({quantity.unit})", *_words(decision, quantity.scale)])
    return rows


def _words(decision: Decision, scale: float) -> list[str]:
    numbers = (decision.deviation, decision.expanded_uncertainty, decision.tolerance)
    return [*(f"{number * scale:.4f}" for number in numbers), decision.state, decision.advice]


def _add_remarks(document: Document, solved: SolvedRun) -> None:
    result = solved.result
    left_out = [
        [f"image {number}", str(image.stamp_ns), image.reason or "no reason stated"]
        for number, image in enumerate(result.images, start=1)
        if not image.used
    ] + [
        [f"target {o.target_id}", str(o.stamp_ns), o.reason or "no reason stated"]
        for o in result.observations
        if not o.used
    ]
    document.heading("Left out", level=3)
    if left_out:
        document.table([["what", "stamp (ns)", "why"], *left_out], widths=(1, 2, 4))
    else:
        document.paragraph("Nothing.")
    solution = result.solution
    for words in (*solved.notices, *solution.remarks, *result.findings, *solution.poor):
        document.paragraph(words)


def _add_comparison(document: Document, runs: Sequence[SolvedRun]) -> None:
    document.heading("First and last")
    first, last = runs[0].result.solution.theta, runs[-1].result.solution.theta
    rows = [
        [q.symbol, *(f"{v * q.scale:.4f}" for v in (first[k], last[k], last[k] - first[k])), q.unit]
        for k, q in enumerate(THETA)
    ]
    document.table([["quantity", "first", "last", "change", "unit"], *rows])


def _input_files(solved: SolvedRun) -> dict[str, bytes]:
    """Return what was solved with: the named files, else those beside, else those inside."""
    found: dict[str, bytes] = {}
    with Recording(solved.run) as recording:
        for name, option in _FILES:
            if name == "machine.yaml" and solved.machine is None:
                continue
            named = getattr(solved.options, option)
            path = named or recording.run.beside(name)
            content = path.read_bytes() if path is not None else recording.attachment(name)
            if content is not None:
                found[name] = content
    return found


def _seals(run: Path) -> list[dict[str, str]]:
    return [_seal(path) for path in find_run(run).recordings]


def _seal(path: Path) -> dict[str, str]:
    sha256 = _sha256(path)
    try:
        verdict = verify(path)
    except InputError:
        words = "no seal: nobody can say whether it was changed"
        return {"file": path.name, "sha256": sha256, "verdict": words}
    words = f"seal {verdict.sha256}; "
    words += "as it was recorded" if verdict.intact else "NOT as it was recorded"
    words += f"; signed by {verdict.public_key}" if verdict.signed else "; signed by nobody"
    return {"file": path.name, "sha256": sha256, "verdict": words}


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()
