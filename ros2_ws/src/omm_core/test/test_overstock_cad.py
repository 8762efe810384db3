"""Faces out of CAD: surfaces as what they are, files of every kind, refusals."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from omm_core.errors import InputError
from omm_core.overstock.cad import load_faces
from omm_core.overstock.face import Face
from omm_core.overstock.recognise import recognised
from omm_core.overstock.step_text import read_words

DATA = Path(__file__).parents[4] / "test" / "data" / "cad"
ONE = np.zeros((1, 3, 3))
AXIS = np.array([0.0, 0.6, 0.8])
ORIGIN = np.array([10.0, -20.0, 30.0])
SHAPES = {
    "plane": {},
    "cylinder": {"radius_mm": 40.0},
    "cone": {"half_angle_rad": 0.4},
    "sphere": {"radius_mm": 50.0},
    "torus": {"radius_mm": 12.0, "ring_radius_mm": 60.0},
}


def shape(kind, sign=1.0):
    return Face(kind=kind, triangles=ONE, origin=ORIGIN, axis=AXIS, sign=sign, **SHAPES[kind])


def near(random, count=50):
    return ORIGIN + random.uniform(-60.0, 60.0, (count, 3)) + 80.0 * AXIS


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_distance_falls_by_one_along_the_normal(kind, sign):
    """The foot of a point lies on the surface, and the normal is the distance's gradient."""
    face = shape(kind, sign)
    points = near(np.random.default_rng(0))
    distance, normals = face.distance(points)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(points)))
    on, same = face.distance(points - distance[:, None] * normals)
    assert on == pytest.approx(np.zeros(len(points)), abs=1e-9)
    assert (same * normals).sum(axis=1) == pytest.approx(np.ones(len(points)))
    for axis in np.eye(3):
        slope = (face.distance(points + 1e-4 * axis)[0] - distance) / 1e-4
        assert slope == pytest.approx(normals @ axis, abs=1e-4)


def cone(sections=48):
    """Return a mesh of the side of a cone's frustum, radii 50 and 30, 60 high."""
    turns = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    rim = np.c_[np.cos(turns), np.sin(turns)]
    low, high = np.c_[50.0 * rim, np.zeros(sections)], np.c_[30.0 * rim, np.full(sections, 60.0)]
    after = np.roll(np.arange(sections), -1)
    here = np.arange(sections)
    first = np.stack([low[here], low[after], high[after]], axis=1)
    return np.concatenate([first, np.stack([low[here], high[after], high[here]], axis=1)])


def moved(triangles):
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])[:3, :3]
    return triangles @ turn.T + [120.0, 30.0, -400.0]


def test_facets_are_known_for_the_surface_their_corners_lie_on():
    tube = trimesh.creation.cylinder(40.0, 100.0, sections=60)
    side = tube.triangles[np.abs(tube.face_normals[:, 2]) < 0.5]
    ball = trimesh.creation.icosphere(3, radius=25.0).triangles
    assert recognised(moved(side)).radius_mm == pytest.approx(40.0, abs=1e-6)
    assert recognised(moved(ball)).radius_mm == pytest.approx(25.0, abs=1e-6)
    assert recognised(moved(cone())).half_angle_rad == pytest.approx(np.arctan(1 / 3), abs=1e-9)
    hollow = recognised(moved(side[:, ::-1]))
    assert (hollow.kind, hollow.sign) == ("cylinder", -1.0)
    wavy = moved(ball) * [1.0, 1.2, 1.0]
    assert recognised(wavy) is None


def part_mesh():
    block = trimesh.creation.box(extents=[200.0, 120.0, 80.0])
    boss = trimesh.creation.cylinder(25.0, 50.0, sections=90)
    boss.apply_translation([20.0, 10.0, 100.0])
    return trimesh.util.concatenate([block, boss])


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply"])
def test_every_mesh_file_gives_the_same_faces(tmp_path, kind):
    path = tmp_path / f"part.{kind[:3]}"
    exported = part_mesh().export(file_type=kind)
    path.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
    faces = load_faces(path)
    kinds = sorted(face.kind for face in faces)
    assert kinds == ["cylinder"] + ["plane"] * 8
    boss = next(face for face in faces if face.kind == "cylinder")
    assert boss.radius_mm == pytest.approx(25.0, abs=1e-3)
    assert boss.origin[:2] == pytest.approx([20.0, 10.0], abs=1e-3)


def test_the_unit_of_a_mesh_is_what_is_told(tmp_path):
    path = tmp_path / "part.stl"
    path.write_bytes(part_mesh().export(file_type="stl"))
    faces = load_faces(path, None, 25.4)
    assert max(face.index.high[0] for face in faces) == pytest.approx(2540.0)


def test_a_smooth_body_is_cut_into_its_planes_and_the_rest(tmp_path):
    """A block with rounded edges has no sharp bend anywhere."""
    turns = np.linspace(0.0, np.pi / 2, 8)
    corners = [np.array([90.0, 50.0]), np.array([-90.0, 50.0])]
    corners += [-corners[0], -corners[1]]
    outline = [
        c + 10.0 * np.array([np.cos(t + k * np.pi / 2), np.sin(t + k * np.pi / 2)])
        for k, c in enumerate(corners)
        for t in turns
    ]
    count = len(outline)
    low = np.c_[outline, np.zeros(count)]
    high = low + [0.0, 0.0, 40.0]
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    side = np.concatenate(
        [
            np.stack([low[here], low[after], high[after]], axis=1),
            np.stack([low[here], high[after], high[here]], axis=1),
        ]
    )
    path = tmp_path / "side.stl"
    corners_of = np.arange(3 * len(side)).reshape(-1, 3)
    path.write_bytes(trimesh.Trimesh(side.reshape(-1, 3), corners_of).export(file_type="stl"))
    kinds = sorted(face.kind for face in load_faces(path))
    assert kinds == ["cylinder"] * 4 + ["plane"] * 4


def test_corner_normals_take_most_of_the_chords_error_away():
    ball = trimesh.creation.icosphere(3, radius=100.0)
    chord = Face(kind="free", triangles=ball.triangles, origin=np.zeros(3), axis=AXIS)
    bulging = Face(
        kind="free",
        triangles=ball.triangles,
        origin=np.zeros(3),
        axis=AXIS,
        corner_normals=ball.vertices[ball.faces] / 100.0,
    )
    points = np.random.default_rng(1).normal(size=(200, 3))
    points *= 105.0 / np.linalg.norm(points, axis=1, keepdims=True)
    errors = [np.abs(face.distance(points)[0] - 5.0).max() for face in (chord, bulging)]
    assert errors[0] > 0.2
    assert errors[1] < 0.06 * errors[0]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("part.stl", b"not triangles"),
        ("part.step", b"not STEP"),
        ("part.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"),
        ("part.dwg", b""),
    ],
)
def test_what_is_no_cad_is_told(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError):
        load_faces(tmp_path / name)


def test_words_of_a_step_file():
    words = read_words((DATA / "colours.step").read_text())
    assert [face.kind for face in words.faces] == ["plane"] * 6
    assert [face.colour for face in words.faces] == ["", "#ff0000", "", "", "", "#ff0000"]
    assert "STYLED_ITEM" not in words.without_presentation
    assert words.without_presentation.count("ADVANCED_FACE") == 6


def test_names_of_faces_are_read():
    text = (DATA / "colours.step").read_text().replace("ADVANCED_FACE(''", "ADVANCED_FACE('it''s'")
    assert {face.label for face in read_words(text).faces} == {"it's"}


def test_an_assembly_is_refused():
    with pytest.raises(InputError, match="assembly"):
        load_faces(DATA / "assembly.step")


@pytest.fixture
def step():
    pytest.importorskip("cascadio", reason="the optional reader for STEP is not installed")


def test_a_step_file_gives_surfaces_as_what_they_are(step):
    faces = load_faces(DATA / "solids.step")
    found = {face.kind: face for face in faces if face.kind != "plane"}
    assert set(found) == {"cylinder", "cone", "sphere", "torus"}
    assert (found["cylinder"].radius_mm, found["cylinder"].sign) == (pytest.approx(25.0), -1.0)
    assert found["sphere"].origin == pytest.approx([250.0, 50.0, 100.0])
    assert np.tan(found["cone"].half_angle_rad) == pytest.approx(1 / 3)
    torus = found["torus"]
    assert (torus.ring_radius_mm, torus.radius_mm, torus.sign) == pytest.approx((30.0, 10.0, -1.0))
    for face in faces:
        corners = face.triangles.reshape(-1, 3)
        assert np.abs(face.distance(corners)[0]).max() < 1e-3
        lean = (face.distance(face.triangles.mean(axis=1))[1] * face.normals).sum(axis=1)
        assert np.median(lean) > 0.99


def test_a_step_file_in_inch_gives_the_same_part(step):
    for mm, inch in zip(
        load_faces(DATA / "solids.step"), load_faces(DATA / "solids_inch.step"), strict=True
    ):
        assert mm.kind == inch.kind
        assert mm.radius_mm == pytest.approx(inch.radius_mm, abs=1e-6)
        assert mm.middle == pytest.approx(inch.middle, abs=1e-3)


def test_coloured_faces_keep_surface_and_colour(step):
    faces = load_faces(DATA / "colours.step")
    assert [face.kind for face in faces] == ["plane"] * 6
    red = [face.name for face in faces if face.colour == "#ff0000"]
    assert red == ["plane (1 0 0) at 300.000", "plane (0 0 1) at 100.000"]
