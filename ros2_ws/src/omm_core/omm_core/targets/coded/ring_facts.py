"""What is found out about a ring, and what of it speaks against the ring or its dot."""

from __future__ import annotations

import math

import numba

FACTS = 9
PHASE, MARGIN, SECTOR_ERROR, PROFILE_RMS, GAP, BEFORE, BEYOND, LARGEST, STANDS_OUT = range(FACTS)
"""Places of the facts of `read_ring`."""
MAX_GAP = 0.45
"""Largest deviation from the background between dot and ring."""
MAX_BESIDE = 0.35
"""Largest share of the set samples that is still set where the ring must have ended."""
MIN_MARGIN = 0.15
"""A sector nearer to the threshold (of a contrast of 1) is doubtful."""
MAX_SECTOR_ERROR = 0.28
"""How far a sector may be from what dot, blur and bits predict."""
MAX_PROFILE_RMS = 0.17
"""The same for the root mean square around the ring."""
NONE, CUT, NO_RING, UNCLEAR, COVERED, FILLED, OTHER_WIDTH, SHADED, NO_DOT = range(9)
"""What may speak against a ring, in the order in which it is asked; or against its dot."""


@numba.njit(cache=True, error_model="numpy")
def doubt(facts):
    """Return what speaks against a ring, from the facts of `read_ring`."""
    if math.isnan(facts[PHASE]):
        return CUT
    if facts[LARGEST] < 0.5 or facts[PROFILE_RMS] > 2.0 * MAX_PROFILE_RMS:
        return NO_RING
    if facts[MARGIN] < MIN_MARGIN:
        return UNCLEAR
    if facts[SECTOR_ERROR] > MAX_SECTOR_ERROR or facts[PROFILE_RMS] > MAX_PROFILE_RMS:
        return COVERED
    if facts[GAP] > MAX_GAP:
        return FILLED
    if max(facts[BEFORE], facts[BEYOND]) > MAX_BESIDE:
        return OTHER_WIDTH
    if facts[STANDS_OUT] > 1.0:
        return SHADED
    return NONE
