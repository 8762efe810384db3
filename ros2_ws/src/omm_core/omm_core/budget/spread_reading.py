"""How a spread is written in budget.yaml: a distribution, a σ, degrees of freedom."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from omm_core.budget.distributions import Distribution
from omm_core.errors import InputError, warn
from omm_core.files.declared import per_axis
from omm_core.files.yaml_input import YamlSection

Array = NDArray[np.float64]

_SIGMAS = ("standard_uncertainty", "sigma", "sigma_mm")
SPREAD_KEYS = (*_SIGMAS, "distribution", "half_width", "coverage_factor", "degrees_of_freedom")


def read_spread(section: YamlSection, more: tuple[str, ...] = ()) -> Distribution:
    """Read a distribution: standard_uncertainty, or half_width, with degrees of freedom."""
    section.check_keys(*SPREAD_KEYS, *more)
    kind = section.text("distribution").lower() if "distribution" in section else "normal"
    freedom = math.inf
    if "degrees_of_freedom" in section and section.get("degrees_of_freedom") != math.inf:
        freedom = section.number("degrees_of_freedom", above=0.0)
    try:
        given = [key for key in (*_SIGMAS, "half_width") if key in section]
        if len(given) > 1:
            raise InputError(f"Expected one of {' and '.join(given)}, got both.")
        sigma = next((key for key in _SIGMAS if key in section), None)
        if sigma is not None:
            value = section.number(sigma, least=0.0)
            return Distribution(kind=kind, standard_uncertainty=value, degrees_of_freedom=freedom)
        half = section.number("half_width", least=0.0)
        if "coverage_factor" in section or kind in ("normal", "gaussian"):
            return Distribution(
                kind=kind,
                standard_uncertainty=half / _factor(section),
                degrees_of_freedom=freedom,
            )
        return Distribution.from_half_width(kind, half, freedom)
    except InputError as error:
        text = str(error)
        raise InputError(text if section.where in text else f"{section.where}: {text}") from None


def _factor(section: YamlSection) -> float:
    """Return what a half width was multiplied with; a normal distribution has no other limits."""
    if "coverage_factor" in section:
        return section.number("coverage_factor", above=0.0)
    warn(f"{section.where}: half_width of a normal distribution is taken as U with k = 2.")
    return 2.0


def read_sigma(section: YamlSection) -> Array:
    """Read ``sigma_mm``: one number for all axes, or one for each."""
    return np.asarray(per_axis(least=0.0).read(section, "sigma_mm"))
