"""What a result rests on and what follows from it: files, seals, decisions. For reports."""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

from omm_core.alignment.tolerance import Decision, decide
from omm_core.errors import InputError
from omm_core.files.strict_yaml import parse_yaml
from omm_core.session.quantities import THETA, Quantity
from omm_recording.reading import Recording
from omm_recording.run_files import find_run
from omm_recording.verifying import verify
from omm_report.language import Said, say
from omm_runs.solving import SolvedRun

_FILES = (
    ("part.yaml", "part_file"),
    ("camera.yaml", "calibration_file"),
    ("machine.yaml", "machine_file"),
)


def decisions(
    solved: SolvedRun, uncertainty: Sequence[float], part: bytes
) -> list[tuple[Quantity, Decision]]:
    """Return the decision of each quantity that has a tolerance, about its nominal value."""
    stated = parse_yaml(part, "The part file") or {}
    tolerances, nominal = stated.get("tolerances") or {}, stated.get("nominal") or {}
    angles = nominal.get("euler_xyz_rad") or [None] * 3
    wanted = [*angles, *(nominal.get("translation_mm") or [None] * 3)]
    decided = []
    for k, quantity in enumerate(THETA[:6]):
        if tolerances.get(quantity.key) is None or wanted[k] is None:
            continue
        deviation = float(solved.result.solution.theta[k]) - float(wanted[k])
        if k < 3:  # the turn by less than 180 degrees
            deviation = math.remainder(deviation, 2.0 * math.pi)
        decision = decide(deviation, uncertainty[k], float(tolerances[quantity.key]))
        decided.append((quantity, decision))
    return decided


def input_files(solved: SolvedRun) -> dict[str, bytes]:
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


def seal_words(seal: dict[str, str]) -> list[Said]:
    """Return what a seal says, to be said in a reader's language."""
    verdict = seal["verdict"]
    if not verdict.startswith("seal "):
        return [say("doc.no_seal")]
    sealed, intact, signed = verdict.split("; ")
    key = signed.removeprefix("signed by ")
    return [
        say("doc.seal", sha=sealed.removeprefix("seal ")),
        say("doc.intact" if intact == "as it was recorded" else "doc.changed"),
        say("doc.unsigned") if key == "nobody" else say("doc.signed", by=key),
    ]


def seals_of(run: Path) -> list[dict[str, str]]:
    """Return each recording's file, checksum, and what its seal says (in English)."""
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
