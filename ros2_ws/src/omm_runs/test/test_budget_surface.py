"""U over the CAD is U at those places; what does not belong to the part is told."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from omm_core.errors import InputError
from omm_core.overstock.cad import load_faces
from omm_core.overstock.pieces import cut_small
from omm_core.overstock.triangles import triangle_areas
from omm_runs.budget_surface import surface_map_of
from omm_runs.budgeting import load_sources

PART = """
part: {name: block}
target_family: aicon12
targets:
  - {id: 1, xyz_mm: [0, 0, 0], dot_diameter_mm: 5}
  - {id: 2, xyz_mm: [1500, 0, 0], dot_diameter_mm: 5}
  - {id: 3, xyz_mm: [1500, 1000, 0], dot_diameter_mm: 5}
nominal: {translation_mm: [0, 0, 0], euler_xyz_rad: [0, 0, 1.5707963267948966]}
"""
BUDGET = """
part: part.yaml
cad: block.stl
u_it: {expansion_per_K: 10.0e-6, temperature_K: {standard_uncertainty: 1}}
"""


@pytest.fixture
def surface(tmp_path: Path):  # type: ignore[no-untyped-def]
    def made(text: str = BUDGET, scale: float = 1.0):  # type: ignore[no-untyped-def]
        block = trimesh.creation.box(extents=(1500 * scale, 1000 * scale, 500 * scale))
        block.apply_translation(np.array([750.0, 500.0, 250.0]) * scale)
        block.export(tmp_path / "block.stl")
        (tmp_path / "part.yaml").write_text(PART)
        (tmp_path / "budget.yaml").write_text(text)
        return surface_map_of(load_sources(tmp_path))

    return made


def test_u_over_the_cad_is_the_closed_form_at_each_corner(surface) -> None:  # type: ignore[no-untyped-def]
    found, told = surface()
    assert told == ()
    # The part is turned by 90° about z: its y lies along machine X, its x along machine Y.
    expected = 2e-5 * np.abs(found.corners[..., [1, 0, 2]])
    assert found.expanded_mm == pytest.approx(expected, abs=1e-9)
    x, y, z = found.table()
    assert (x.largest_mm, y.largest_mm, z.largest_mm) == pytest.approx((0.02, 0.03, 0.01))
    assert y.worst_xyz_mm[0] == pytest.approx(1500.0)
    assert y.worst_face.startswith("plane")
    # Mean of |x| over the block's faces, by area.
    sides, tops, fronts = 1000 * 500.0, 1500 * 1000.0, 1500 * 500.0
    mean = (sides * 1500 + 2 * (tops + fronts) * 750) / (2 * (sides + tops + fronts))
    assert y.mean_mm == pytest.approx(2e-5 * mean, rel=1e-6)


def test_triangles_are_small_and_cover_the_same_area(tmp_path: Path) -> None:
    trimesh.creation.cylinder(radius=100.0, height=400.0).export(tmp_path / "round.stl")
    faces = load_faces(tmp_path / "round.stl")
    corners, face = cut_small(faces, pieces=20.0, most=50_000)
    diagonal = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() <= diagonal / 20.0
    for number, one in enumerate(faces):
        own = triangle_areas(corners[face == number]).sum()
        assert own == pytest.approx(triangle_areas(one.triangles).sum(), rel=1e-9)
    few, _ = cut_small(faces, pieces=1000.0, most=100)
    assert len(few) == sum(len(one.triangles) for one in faces) + 100


def test_a_cad_of_another_unit_is_told(surface) -> None:  # type: ignore[no-untyped-def]
    _, told = surface(scale=1 / 25.4)
    assert "cad_unit" in told[0]
    _, told = surface(BUDGET + "cad_unit: inch\n", scale=1 / 25.4)
    assert told == ()
    _, told = surface(scale=1000.0)
    assert "cad_unit" in told[0]


def test_without_a_cad_there_is_none_and_an_unknown_unit_is_refused(surface) -> None:  # type: ignore[no-untyped-def]
    assert surface(BUDGET.replace("cad: block.stl", "")) == (None, ())
    with pytest.raises(InputError, match="cad_unit"):
        surface(BUDGET + "cad_unit: furlong\n")
