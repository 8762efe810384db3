"""A block in its blank, as a survey and a fit file would bring it."""

import numpy as np
from scipy.spatial.transform import Rotation

from omm_core.files.points import SurveyPoint, SurveyPoints
from omm_core.overstock.face import Face
from omm_core.overstock.fit_file import FitFile

SIZE = np.array([1000.0, 400.0, 300.0])
# survey_T_part: nobody's frame is the part's.
TURN = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
SHIFT = np.array([1500.0, -300.0, 800.0])
CORNERS = np.array([[60.0, 60, 305], [940, 60, 306], [940, 340, 305], [60, 340, 307]])


def block_faces(size=SIZE, pad=None):
    """Return the six planes of a block, and five more of a pad (low, high) on its top."""
    faces = _box(np.zeros(3), np.asarray(size))
    return faces + (
        _box(*map(np.asarray, pad))[:4] + _box(*map(np.asarray, pad))[5:] if pad else ()
    )


def _box(low, high):
    faces = []
    for axis in range(3):
        for side, sign in enumerate((-1.0, 1.0)):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            corners = np.array([low] * 4, dtype=float)
            corners[[1, 2], a] = high[a]
            corners[[2, 3], b] = high[b]
            corners[:, axis] = (low, high)[side][axis]
            order = [[0, 1, 2], [0, 2, 3]] if sign > 0 else [[0, 2, 1], [0, 3, 2]]
            normal = sign * np.eye(3)[axis]
            triangles = corners[np.array(order)]
            faces.append(Face(kind="plane", triangles=triangles, origin=corners[0], axis=normal))
    return tuple(faces)


def raw_points(faces, stock, per=16, seed=1, rough=0.0, inset=0.03):
    """Return points (part frame) on raw faces at these stocks, normals, and the face of each."""
    random = np.random.default_rng(seed)
    points, normals, numbers = [], [], []
    for number, (face, height) in enumerate(zip(faces, stock, strict=True)):
        if height is None:
            continue
        low, high = face.index.low, face.index.high
        p = low + (high - low) * random.uniform(inset, 1.0 - inset, (per, 3))
        p = p - np.outer((p - face.origin) @ face.axis, face.axis)
        heights = height + rough * random.standard_normal(per)
        points.append(p + heights[:, None] * face.axis)
        normals += [face.axis] * per
        numbers += [number] * per
    return np.vstack(points), np.array(normals), np.array(numbers)


def survey(points, normals, *, sigma=0.02, coded=CORNERS, with_normals=True, full=None):
    """Return the survey of points given in the part frame; p1, p2, … and coded 101, 102, …"""
    covariance = None if sigma is None else sigma**2 * np.eye(3)
    measured = [
        SurveyPoint(
            name=f"p{n}",
            id=None,
            xyz_mm=TURN @ p + SHIFT,
            normal=TURN @ normal if with_normals else None,
            covariance_mm2=covariance,
        )
        for n, (p, normal) in enumerate(zip(points, normals, strict=True), start=1)
    ]
    targets = [
        SurveyPoint(
            name=str(101 + n),
            id=101 + n,
            xyz_mm=TURN @ p + SHIFT,
            normal=TURN[:, 2],
            covariance_mm2=covariance,
        )
        for n, p in enumerate(coded)
    ]
    return SurveyPoints(
        target_family="metashape12",
        coded_dot_diameter_mm=8.0,
        points=tuple(measured + targets),
        full=full,
    )


def fit_file(tmp_path, *, off_mm=0.0, pairs=True, **given):
    """Return what is asked for, its pairs off by so many mm."""
    random = np.random.default_rng(5)
    wanted = {
        str(101 + n): p + off_mm * random.uniform(-1.0, 1.0, 3) for n, p in enumerate(CORNERS)
    }
    return FitFile(
        points=tmp_path / "points.json",
        cad=tmp_path / "part.stl",
        target_thickness_mm=given.pop("target_thickness_mm", 0.0),
        pairs=wanted if pairs else {},
        **given,
    )
