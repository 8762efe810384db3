"""The tables of codes follow from their rules and match what is published."""

import pytest

from omm_core.errors import InputError
from omm_core.targets import TargetFamily, family_names
from omm_core.targets.coded.choosing import propose_ids, separation
from omm_core.targets.coded.families import mirror_code, rotate_code

# Published by the makers: number of codes, and the first of the 12-bit families.
COUNTS = {
    "aicon12": 147,
    "aicon14": 516,
    "aicon16": 1861,
    "aicon20": 24793,
    "metashape12": 161,
    "metashape14": 561,
    "metashape16": 2001,
    "metashape20": 26013,
}


@pytest.mark.parametrize("name", family_names())
def test_count_is_the_published_one(name):
    assert len(TargetFamily.by_name(name)) == COUNTS[name]


def test_first_codes_are_the_published_ones():
    assert TargetFamily.by_name("aicon12").codes[:4].tolist() == [65, 71, 75, 77]
    assert TargetFamily.by_name("metashape12").codes[:4].tolist() == [71, 75, 77, 83]


def test_102_of_147_codes_differ_from_their_mirror_image():
    codes = TargetFamily.by_name("aicon12").codes
    assert sum(mirror_code(int(code), 12) != code for code in codes) == 102


def test_146_codes_stand_in_both_families():
    aicon, metashape = (TargetFamily.by_name(f"{maker}12") for maker in ("aicon", "metashape"))
    assert len(set(aicon.codes.tolist()) & set(metashape.codes.tolist())) == 146


@pytest.mark.parametrize("name", ["aicon14", "metashape12"])
def test_number_is_found_from_every_rotation(name):
    family = TargetFamily.by_name(name)
    for target_id in (1, 2, len(family) // 2, len(family)):
        code = family.code_of(target_id)
        for steps in range(family.bits):
            assert family.id_of(rotate_code(code, steps, family.bits)) == target_id


def test_what_is_no_code_has_no_number():
    assert TargetFamily.by_name("metashape12").id_of(65) is None
    with pytest.raises(InputError, match="1 to 161"):
        TargetFamily.by_name("metashape12").code_of(162)
    with pytest.raises(InputError, match="aicon12"):
        TargetFamily.by_name("aicon13")


def _slow_separation(family, ids):
    """Distance and arc by trying all rotations and all arcs."""
    n = family.bits
    least, shortest = n, n
    for i, a in enumerate(ids):
        for b in ids[i + 1 :]:
            for steps in range(n):
                differ = family.code_of(a) ^ rotate_code(family.code_of(b), steps, n)
                least = min(least, differ.bit_count() if hasattr(int, "bit_count") else 0)
                for length in range(n + 1):
                    arc = (1 << length) - 1
                    if any(differ & ~rotate_code(arc, s, n) == 0 for s in range(n)):
                        shortest = min(shortest, length)
                        break
    return least, shortest


def test_separation_is_that_of_trying_everything():
    family = TargetFamily.by_name("metashape12")
    ids = (3, 17, 42, 99, 140)
    result = separation(family, ids)
    assert (result.distance, result.arc) == _slow_separation(family, ids)


def test_proposed_numbers_are_farther_apart_than_the_first_ones():
    family = TargetFamily.by_name("metashape12")
    proposal = propose_ids(family, 8)
    assert len(set(proposal.ids)) == 8
    first = separation(family, tuple(range(1, 9)))
    assert (proposal.distance, proposal.arc) > (first.distance, first.arc)
    assert proposal.distance >= 4
    codes = {family.code_of(i) for i in proposal.ids}
    assert not any(mirror_code(c, 12) in codes - {c} for c in codes)
    assert "of 12 sectors" in proposal.why()
