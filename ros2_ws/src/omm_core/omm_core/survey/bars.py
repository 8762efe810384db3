"""Whether scale bars agree with each other, before they take part."""

from __future__ import annotations

import numpy as np

from omm_core.errors import MeasurementError
from omm_core.survey.network import Network
from omm_core.survey.sighting import Bar

_DISAGREE = 5.0  # sigmas of the scale of one bar against that of the others
_REFUSED = 10.0
_DOUBTED = 2.5  # from which on it is told


def agreeing_bars(network: Network, bars: list[Bar]) -> tuple[list[Bar], list[str]]:
    """Return the bars that tell one scale, and what must be told of the others.

    Parameters
    ----------
    network : Network
        Adjusted without any bar.

    Raises
    ------
    MeasurementError
        Where no bar is seen, or two disagree so much that the scale is not known.
    """
    there = [b for b in bars if all(end in network.points for end in b.ends)]
    if not there:
        raise MeasurementError(
            "Expected at least one scale bar whose two ends are seen in three photographs each;"
            " found none, so the coordinates have no scale. Photograph the bars more often."
        )
    words = []
    while len(there) > 1:
        worst, off, sigmas = _worst(network, there)
        if sigmas < _DOUBTED:
            break
        name = f"{worst.ends[0]}-{worst.ends[1]}"
        told = f"{off:+.4f} mm off the {worst.length_mm:.4f} mm declared, {sigmas:.1f} sigma"
        if len(there) == 2:
            other = next(b for b in there if b is not worst)
            both = f"{name} and {other.ends[0]}-{other.ends[1]}"
            if sigmas > _REFUSED:
                raise MeasurementError(
                    f"The scale bars {both} disagree: measured by the other, {name} comes out"
                    f" {told}. One of their lengths or numbers is wrong; two bars cannot tell"
                    f" which. Correct it, or leave the doubtful bar out."
                )
        if len(there) == 2 or sigmas < _DISAGREE:
            words.append(
                f"The scale bars hardly agree: measured by the others, {name} comes out {told}."
                " All of them are used; the scale may be wrong by as much. Check their lengths."
            )
            break
        words.append(
            f"The scale bars disagree: {name} comes out {told}; it is left out. Check its length"
            " and the numbers of its ends."
        )
        there.remove(worst)
    return there, words


def _worst(network: Network, bars: list[Bar]) -> tuple[Bar, float, float]:
    """Return the bar that differs most from the others' scale: by how much, mm and sigmas."""
    lengths, sigmas = np.array([network.length(b.ends) for b in bars]).T
    declared = np.array([b.length_mm for b in bars])
    scales = np.log(declared / lengths)
    spread = np.hypot(sigmas / lengths, [b.sigma_mm / b.length_mm for b in bars])
    tests, offs = np.zeros(len(bars)), np.zeros(len(bars))
    for i in range(len(bars)):
        others = np.delete(np.arange(len(bars)), i)
        middle = float(np.median(scales[others]))
        uncertain = float(np.min(spread[others]))
        offs[i] = (np.exp(middle - scales[i]) - 1.0) * declared[i]
        tests[i] = abs(scales[i] - middle) / np.hypot(spread[i], uncertain)
    worst = int(np.argmax(tests))
    return bars[worst], float(offs[worst]), float(tests[worst])
