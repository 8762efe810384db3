"""A campaign as people read it: the paper's tables 2 and 3, the analysis, and what it means."""

from __future__ import annotations

import math
from typing import Any

from omm_core.budget.campaign import Campaign, QuantityStudy
from omm_core.budget.gauge import Prediction
from omm_core.session.quantities import THETA, Quantity

# The paper's order of columns.
_COLUMNS = (3, 4, 5, 0, 1, 2, 6)
PAPER = {
    "paper 6D, table 2": (0.136, 0.056, 0.026, 0.039, 0.056, 0.070, math.nan),
    "paper 7D, table 3": (0.032, 0.030, 0.020, 0.028, 0.024, 0.010, 3.840),
}


def campaign_lines(campaign: Campaign, *, beside_paper: bool = False) -> list[str]:
    """Return the tables of a campaign."""
    return [
        headline(campaign),
        "",
        *_table(two_sigma_rows(campaign, beside_paper=beside_paper), 18),
        "",
        *_table(analysis_rows(campaign), 8),
        "",
        *verdict_lines(campaign),
    ]


def headline(campaign: Campaign) -> str:
    """Return how much was measured, in a line."""
    most, least = max(campaign.repeats), min(campaign.repeats)
    repeats = f"{most}" if most == least else f"{least} to {most}"
    return (
        f"{campaign.clampings} clampings, {repeats} repeats each,"
        f" {len(campaign.measured)} measurements"
    )


def two_sigma_rows(campaign: Campaign, *, beside_paper: bool = False) -> list[list[str]]:
    """Return twice the standard deviations of all measurements, as the paper's tables have them."""
    rows = [["2σ", *(f"{THETA[i].symbol} {THETA[i].unit}" for i in _COLUMNS)]]
    kinds = {"6D, table 2": "sigma_6d", "7D, table 3": "sigma"}
    found = {}
    for words, key in kinds.items():
        values = found[key] = [
            2.0 * THETA[i].scale * getattr(campaign.quantities[i], key) for i in _COLUMNS
        ]
        if key == "sigma_6d":
            values[-1] = math.nan  # given there, not measured
        if not all(math.isnan(value) for value in values):
            rows.append([words, *(_number(value, 4) for value in values)])
    six, seven = found["sigma_6d"][:-1], found["sigma"][:-1]
    if not all(math.isnan(value) for value in six) and min(seven) > 0.0:
        factors = [_number(a / b, 1) for a, b in zip(six, seven)]
        rows.append(["6D / 7D", *factors, _number(math.nan, 1)])
    if beside_paper:
        rows += [[name, *(_number(v, 3) for v in values)] for name, values in PAPER.items()]
    return rows


def analysis_rows(campaign: Campaign) -> list[list[str]]:
    """Return repeatability, reproducibility and capability of each quantity."""
    rows = [
        ["", "unit", "repeat", "clamping", "together", "predicted", "p(F)", "Cg", "Cgk", "%GRR"]
    ]
    for index in _COLUMNS:
        rows.append(_analysis_row(campaign.quantities[index], THETA[index]))
    return rows


def verdict_lines(campaign: Campaign) -> list[str]:
    """Return in words what the campaign says."""
    lines = [
        "repeat: standard deviation within a clamping; clamping: what clampings add; together: of"
        " one measurement; p(F): chance of it without such an addition"
    ]
    found = campaign.prediction
    if found is not None:
        lines += _prediction_lines(found)
    anew = [
        quantity.symbol
        for one, quantity in zip(campaign.quantities, THETA)
        if one.study.p_value < 0.01 / 7 and (quantity.name != "gamma_s" or _known(campaign))
    ]
    if anew:
        lines.append(
            f"Clampings add more than chance to {', '.join(anew)}: how the holder seats, or what"
            " changes between clampings"
        )
    for one, quantity in zip(campaign.quantities, THETA):
        if one.capability is not None:
            width = one.capability.tolerance * quantity.scale
            lines.append(
                f"{quantity.symbol}: {one.capability.verdict} for T = {width:g} {quantity.unit}"
                f" (Cg {one.capability.cg:.2f}, Q_MP {one.capability.q_mp:.1%})"
            )
    if campaign.clampings == 1:
        lines.append("One clamping only: what clampings add is not known, nor in Cg and %GRR")
    elif max(campaign.repeats) == 1:
        lines.append("One repeat in each clamping: repeat and clamping cannot be told apart")
    if all(one.capability is None for one in campaign.quantities):
        lines.append(
            "Without a tolerance (part.yaml's, or tolerance_mm in campaign.yaml) there is no Cg,"
            " Cgk and %GRR"
        )
    drifts = campaign.findings or ("no drift at 1 %",)
    return [*lines, *drifts]


def _prediction_lines(found: Prediction) -> list[str]:
    per = math.sqrt(found.statistic / found.degrees_of_freedom)
    lines = [
        f"{'Believed' if found.believed else 'NOT believed'}: the predicted covariance. Scatter is"
        f" {per:.2f} times the predicted (χ² = {found.statistic:.0f} with"
        f" {found.degrees_of_freedom}, p = {found.p_value:.2g})"
    ]
    if found.against_truth:
        lines.append(
            f"Mean error from the truth: {found.bias:.1f} (χ² with {len(found.ratio)}, p ="
            f" {found.bias_p_value:.2g}); mean normalised squared error {found.squared_error:.2f}"
            f" of {len(found.ratio)}"
        )
    lines.append(
        "What all runs share (calibration, targets, geometry) does not scatter: a prediction can"
        " be found too small here, never too large"
    )
    return lines


def _known(campaign: Campaign) -> bool:
    return all(one.truth is not None for one in campaign.measured)


def campaign_dict(campaign: Campaign) -> dict[str, Any]:
    """Return what ``campaign --json`` writes; null where a number cannot be known."""
    found = campaign.prediction
    return {
        "clampings": campaign.clampings,
        "repeats": list(campaign.repeats),
        "quantities": [_quantity_dict(one) for one in campaign.quantities],
        "table_2": _two_sigma_dict(campaign, "sigma_6d"),
        "table_3": _two_sigma_dict(campaign, "sigma"),
        "prediction": None
        if found is None
        else {
            "believed": found.believed,
            "against_truth": found.against_truth,
            "chi_square": found.statistic,
            "degrees_of_freedom": found.degrees_of_freedom,
            "p_value": found.p_value,
            "bias": _or_none(found.bias),
            "bias_p_value": _or_none(found.bias_p_value),
            "mean_normalised_squared_error": _or_none(found.squared_error),
            "seen_over_predicted": found.ratio.tolist(),
        },
        "runs": [
            {
                "run": one.name,
                "clamping": one.clamping,
                "repeat": one.repeat,
                "theta": {q.key: float(v) for q, v in zip(THETA, one.theta)},
            }
            for one in campaign.measured
        ],
        "findings": list(campaign.findings),
    }


def _quantity_dict(one: QuantityStudy) -> dict[str, Any]:
    study, judged = one.study, one.capability
    return {
        "name": one.name,
        "mean": study.mean,
        "repeatability": _or_none(study.repeatability),
        "between_clampings": _or_none(study.between),
        "reproducibility": _or_none(study.reproducibility),
        "degrees_of_freedom": _or_none(study.degrees_of_freedom),
        "p_value": _or_none(study.p_value),
        "predicted": one.predicted,
        "drift": {
            "per_clamping": _or_none(one.between.per_step),
            "p_value_clamping": _or_none(one.between.p_value),
            "per_repeat": _or_none(one.within.per_step),
            "p_value_repeat": _or_none(one.within.p_value),
        },
        "capability": None
        if judged is None
        else {
            "T": judged.tolerance,
            "Cg": _or_none(judged.cg),
            "Cgk": _or_none(judged.cgk),
            "percent_GRR": 100.0 * judged.grr,
            "Q_MP": judged.q_mp,
            "verdict": judged.verdict,
        },
    }


def _two_sigma_dict(campaign: Campaign, key: str) -> dict[str, float | None]:
    """Return 2σ in mm and mm/m, as the paper prints them."""
    names = {"mm": "mm", "mm/m": "mm_per_m"}
    found = {}
    for one, quantity in zip(campaign.quantities, THETA):
        value = 2.0 * quantity.scale * getattr(one, key)
        if key == "sigma_6d" and quantity.key == "gamma_s_rad":
            value = math.nan
        found[f"{quantity.name}_{names[quantity.unit]}"] = _or_none(value)
    return found


def _analysis_row(one: QuantityStudy, quantity: Quantity) -> list[str]:
    study, scale, judged = one.study, quantity.scale, one.capability
    lengths = (study.repeatability, study.between, study.reproducibility, one.predicted)
    return [
        quantity.symbol,
        quantity.unit,
        *(_number(value * scale, 5) for value in lengths),
        _number(study.p_value, 3),
        *(
            ("–", "–", "–")
            if judged is None
            else (_number(judged.cg, 2), _number(judged.cgk, 2), _number(100 * judged.grr, 1))
        ),
    ]


def _table(rows: list[list[str]], first: int) -> list[str]:
    return [f"{row[0]:<{first}}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in rows]


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
