"""fit.yaml: everything in it is read, and nothing else is."""

import pytest

from omm_core.errors import InputError
from omm_core.files.outside import Text
from omm_core.overstock.fit_file import load_fit_file

WHOLE = """\
points: points.json
cad: part.step
cad_unit: inch
target_thickness_mm: 0.2
minimum_overstock_mm: 1.5
groups:
- {name: milled, faces: [1, 2], maximum_overstock_mm: 4}
- {name: raw, kind: plane, normal: [0, 0, 2], minimum_overstock_mm: null}
tolerances: [{groups: [milled, raw], low_mm: -1, high_mm: 1}]
pairs: [{point: C1, xyz_mm: [1, 2, 3]}]
nominal_targets: [{id: 7, xyz_mm: [4, 5, 6]}]
keep: [C1]
"""


def load(text, tmp_path):
    return load_fit_file(Text(name="fit.yaml", content=text.encode(), folder=tmp_path))


def test_everything_in_a_fit_file_is_read(tmp_path):
    file = load(WHOLE, tmp_path)
    assert (file.points, file.cad) == (tmp_path / "points.json", tmp_path / "part.step")
    assert (file.cad_unit_mm, file.criterion, file.keep) == (25.4, "even", ("C1",))
    milled, raw = file.groups
    assert (milled.faces, milled.minimum_mm, milled.maximum_mm) == ((1, 2), 1.5, 4.0)
    assert raw.minimum_mm is None
    assert raw.normal is not None
    assert raw.normal.tolist() == [0.0, 0.0, 1.0]
    assert file.tolerances[0].groups == ("milled", "raw")
    assert file.pairs["C1"].tolist() == [1.0, 2.0, 3.0]
    assert file.nominal_targets[7].tolist() == [4.0, 5.0, 6.0]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("maximum_overstock_mm: 4", "maximum_overstock_mm: 1", "a maximum above the minimum"),
        ("low_mm: -1", "low_mm: 2", "low_mm <= high_mm"),
        ("name: raw", "name: milled", "each name once"),
        ("[milled, raw], low", "[milled], low", "names of two groups"),
        ("faces: [1, 2]", "faces: [1.5]", "whole numbers of faces"),
        ("inch", "foot", "cad_unit to be one of mm, cm, m, inch"),
        ("xyz_mm: [1, 2, 3]", "xyz_mm: [1, 2]", "expected 3 numbers"),
    ],
)
def test_what_a_fit_file_cannot_mean_is_refused(tmp_path, old, new, told):
    with pytest.raises(InputError, match=told):
        load(WHOLE.replace(old, new), tmp_path)
