"""What each of the four steps shows, as the page gets it (mm, mm/m, px)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from omm_core.alignment.handover import Handover
from omm_core.alignment.jacks import MODES
from omm_core.errors import OmmError
from omm_core.session.quantities import THETA
from omm_core.words import of_error
from omm_operator.screen import result
from omm_operator.screen.correcting import correction_dict, corrections_in_all_modes, remarks
from omm_operator.screen.facts import EstimateFact, FoundFact, OffsetFact, PictureFact
from omm_operator.screen.handing import (
    Condition,
    HandingOptions,
    handover_or_why,
    offset_dict,
    offset_to_write,
)
from omm_operator.screen.watch import Source
from omm_report.language import said_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from omm_operator.screen.history import History
    from omm_operator.screen.screen import Kept
    from omm_operator.screen.troubles import Troubles

LARGEST_SHOWN = 20
NOT_YET = "said.nothing_solved"
number = result.number


def source_dict(source: Source) -> dict[str, Any]:
    """Return how a station is."""
    detail = said_of(source.detail).to_json_dict() if source.detail else None
    return {"name": source.name, "state": source.state, "age_s": source.age_s, "detail": detail}


def troubles(of: Troubles) -> dict[str, Any]:
    """Return the list of errors that nobody has acknowledged, newest first."""
    return {
        "dropped": of.dropped,
        "open": [
            {
                "number": trouble.number,
                "first_ms": trouble.first_ns // 1_000_000,
                "last_ms": trouble.last_ns // 1_000_000,
                "count": trouble.count,
                "said": trouble.said.to_json_dict(),
                "detail": trouble.detail.to_json_dict() if trouble.detail else None,
            }
            for trouble in reversed(of.all())
        ],
    }


def measure(kept: Kept) -> dict[str, Any]:
    """Return the step Measure."""
    control, estimate = kept.control, kept.estimate
    stop = 0
    if control is not None:
        asked = control.measure_requested
        stop = control.measure_request if asked else control.measure_acknowledged
    return {
        "part": estimate.part if estimate else (kept.part.name if kept.part else ""),
        "part_why": said_of(kept.part_why).to_json_dict() if kept.part_why else None,
        "clamping": estimate.clamping if estimate else 0,
        "control": None
        if control is None
        else {
            "name": control.control,
            "connected": control.connected,
            "program_state": control.program_word,
            "program": control.program,
            "line": control.program_line,
            "in_position": control.in_position,
            "moving": said_of(control.moving_reason).to_json_dict()
            if control.moving_reason
            else None,
            "axes": [[name, number(value)] for name, value in control.axes],
        },
        "stop": stop,
        "stops": kept.stops,
        **_images(estimate),
        "pending": estimate.images_pending if estimate else 0,
        "targets": [list(target) for target in estimate.targets] if estimate else [],
        "missing": [said_of(m).to_json_dict() for m in estimate.missing] if estimate else [],
        "picture": _picture(kept.picture, kept.found, estimate),
    }


def result_page(kept: Kept, history: History, *, live: bool, now_ns: int) -> dict[str, Any]:
    """Return the step Result."""
    estimate = kept.estimate
    shown: dict[str, Any] = {"live": live, "history": history.to_json_list(), "rows": []}
    if estimate is None:
        return shown | {"holds": False, "revoked": False, "age_s": None, "advice": "none"}
    found = result.rows(estimate, kept.part)
    return shown | {
        "holds": estimate.holds,
        "revoked": estimate.revoked,
        "revoked_reason": said_of(estimate.revoked_reason).to_json_dict(),
        "age_s": max(0.0, (now_ns - estimate.stamp_ns) / 1e9) if estimate.stamp_ns else None,
        "model": estimate.model,
        "clamping": estimate.clamping,
        "rms_px": number(estimate.rms_px),
        "sigma0": number(estimate.sigma0),
        "degrees_of_freedom": estimate.degrees_of_freedom,
        "rows": [row.to_json_dict() for row in found],
        "advice": result.advice(found) if estimate.holds else "none",
        "findings": [said_of(finding).to_json_dict() for finding in estimate.findings],
        "shares": {
            source: [number(share) for share in shares]
            for source, shares in estimate.shares.items()
        },
        "symbols": [quantity.symbol for quantity in THETA],
    }


def correct(kept: Kept, history: History) -> dict[str, Any]:
    """Return the step Correct."""
    estimate = kept.estimate
    shown: dict[str, Any] = {
        "jacks": [
            {"name": j.name, "x_mm": float(j.xyz_mm[0]), "y_mm": float(j.xyz_mm[1])}
            for j in kept.jacks
        ],
        "modes": {},
        "remarks": {},
        "why": None,
        "nominal": kept.part is not None and kept.part.nominal is not None,
        "corrections": history.corrections(),
    }
    if estimate is None or not estimate.holds or len(kept.jacks) < 3:
        return shown
    try:
        found = corrections_in_all_modes(estimate, kept.part, kept.jacks, kept.up)
    except OmmError as error:
        return shown | {"why": said_of(of_error(error)).to_json_dict()}
    shown["modes"] = {mode: [correction_dict(c) for c in found[mode]] for mode in MODES}
    shown["remarks"] = {
        mode: [said.to_json_dict() for said in remarks(kept.jacks, found[mode])] for mode in MODES
    }
    return shown


@dataclass(frozen=True, kw_only=True, eq=False)
class HandWords:
    """The pose for the control: its words, the numbers to be written, or why there are none."""

    control: str
    offset: str
    handover: Handover | None
    wanted: OffsetFact | None
    why: str


def hand_words(kept: Kept, options: HandingOptions) -> HandWords:
    """Return what would be handed over now."""
    live = kept.control.control if kept.control else ""
    words = options.words_of(live)
    offset, estimate = options.offset_of(words), kept.estimate
    if estimate is None or not estimate.holds:
        return HandWords(control=words, offset=offset, handover=None, wanted=None, why="")
    if live == "opcua" and not options.control:  # numbers into nodes; whose words is not known
        words, handover, why = live, None, ""
    else:
        handover, why = handover_or_why(estimate, kept.part, words, options)
    wanted = offset_to_write(estimate, handover, live, offset)
    return HandWords(control=words, offset=offset, handover=handover, wanted=wanted, why=why)


def hand(kept: Kept, options: HandingOptions, conditions: Sequence[Condition]) -> dict[str, Any]:
    """Return the step Hand over."""
    told = hand_words(kept, options)
    return {
        "control": told.control,
        "offset": told.offset,
        "words": list(told.handover.words.lines) if told.handover else [],
        "unconfirmed": [said_of(line).to_json_dict() for line in told.handover.words.unconfirmed]
        if told.handover
        else [],
        "error_mm": told.handover.error_mm if told.handover else None,
        "remaining_mm": options.remaining_mm,
        "why": said_of(told.why).to_json_dict() if told.why else None,
        "old": offset_dict(kept.offset),
        "new": offset_dict(told.wanted),
        "conditions": [
            {
                "name": condition.name,
                "holds": condition.holds,
                "why": condition.why.to_json_dict() if condition.why else None,
            }
            for condition in conditions
        ],
        "handed": kept.handed,
    }


def _images(estimate: EstimateFact | None) -> dict[str, Any]:
    """Return how many images were used, and the newest that were refused: never all of them."""
    images = estimate.images if estimate else ()
    refused = [
        {"number": at, "why": said_of(image.reason).to_json_dict()}
        for at, image in enumerate(images, start=1)
        if image.refused
    ]
    return {
        "images": len(images),
        "used": sum(image.used for image in images),
        "refused": refused[-LARGEST_SHOWN:],
    }


def _picture(
    picture: PictureFact | None, found: dict[int, FoundFact], estimate: EstimateFact | None
) -> dict[str, Any] | None:
    if picture is None:
        return None
    residuals = {
        r.target_id: r
        for r in (estimate.residuals if estimate else ())
        if r.stamp_ns == picture.stamp_ns
    }
    seen = found.get(picture.stamp_ns, FoundFact(stamp_ns=picture.stamp_ns))
    stamps = [image.stamp_ns for image in (estimate.images if estimate else ())]
    counted = picture.stamp_ns in stamps
    return {
        "number": picture.number,
        "at": stamps.index(picture.stamp_ns) + 1 if counted else None,
        "of": len(stamps),
        "time_ms": picture.stamp_ns // 1_000_000,
        "width": picture.width_px,
        "height": picture.height_px,
        "targets": [
            {"id": target, "col": col, "row": row, **_residual(residuals.get(target))}
            for target, col, row in seen.targets
        ],
        "refused": [
            {"col": col, "row": row, "why": said_of(why).to_json_dict()}
            for col, row, why in seen.refused[:50]
        ],
    }


def _residual(residual: Any) -> dict[str, Any]:
    if residual is None:
        return {"used": None, "residual": None, "why": None}
    said = said_of(residual.reason)
    if said.key == NOT_YET:  # nothing is wrong with it
        return {"used": None, "residual": None, "why": None}
    return {
        "used": residual.used,
        "residual": [number(value) for value in residual.residual_px],
        "why": said.to_json_dict() if residual.reason else None,
    }
