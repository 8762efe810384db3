"""A fit as lines on the screen, and the refusals."""

from __future__ import annotations

from omm_core.errors import MeasurementError
from omm_core.overstock.fit import Fit


def fit_text(fit: Fit) -> str:
    """Return the table of groups, the smallest margin and the notes."""
    result = fit.document
    lines = []
    for row in result["groups"]:
        required = "-" if row["required_mm"] is None else f"{row['required_mm']:.3f}"
        lines.append(
            f"{row['name']:48s} {row['points']:4d} points  smallest {row['minimum_mm']:8.3f} mm"
            f"  mean {row['mean_mm']:8.3f}  required {required}  {row['verdict']}"
        )
    known = result["minimum_margin_U_mm"]
    doubt = "not known" if known is None else f"{known:.4f} mm"
    lines.append(
        f"Smallest margin {result['minimum_margin_mm']:.4f} mm, U {doubt}; limited by"
        f" {', '.join(result['limiting']) or 'nothing'}"
    )
    lines += [f"note: {finding}" for finding in result["findings"]]
    return "\n".join(lines)


def refuse(fit: Fit) -> None:
    """Raise where part.yaml must not be written.

    Raises
    ------
    MeasurementError
        Where several placements fit as well, material is missing, a limit is broken, or nothing
        holds a motion.
    """
    result = fit.document
    if fit.choice.taken is None:
        raise MeasurementError(
            f"{len(fit.choice.settled)} placements fit as well (see above). Say which with"
            " --placement N, or give 3 pairs in fit.yaml. part.yaml is not written."
        )
    if result["breach_mm"] > 1e-6:
        raise MeasurementError(
            f"No placement keeps all limits: {result['breach_mm']:.3f} mm over. part.yaml is not"
            " written."
        )
    if not result["feasible"]:
        raise MeasurementError(
            f"No placement leaves enough material: between {' and '.join(result['limiting'])}"
            f" {result['missing_mm']:.3f} mm are missing. part.yaml is not written."
        )
    if not result["determined"]:
        raise MeasurementError(
            "There is enough material where it was measured, but nothing holds the part in at"
            " least one direction (see above). part.yaml is not written."
        )
