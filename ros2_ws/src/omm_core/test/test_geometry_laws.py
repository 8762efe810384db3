"""Laws of rigid transforms and of the contract's rotations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omm_core.errors import InputError
from omm_core.geometry import RigidTransform, holder_rotation, rotation_from_euler_xyz_rad

angle = st.one_of(
    st.floats(-3.14, 3.14), st.sampled_from([0.0, 1e-9, -1e-9, np.pi / 2, -np.pi / 2])
)
length = st.floats(-20_000, 20_000)
transforms = st.builds(
    lambda a, b, g, x, y, z: RigidTransform.from_euler_xyz_rad(a, b, g, (x, y, z)),
    angle, angle, angle, length, length, length,
)  # fmt: skip
laws = settings(max_examples=60, deadline=None)


def assert_same(a: RigidTransform, b: RigidTransform) -> None:
    assert np.allclose(a.rotation, b.rotation, atol=1e-12)
    assert np.allclose(a.translation_mm, b.translation_mm, atol=1e-8)


@laws
@given(transforms, transforms, transforms)
def test_composition_is_associative(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c))


@laws
@given(transforms)
def test_inverse_composed_with_itself_is_identity(a):
    assert_same(a @ a.inverse(), RigidTransform.identity())
    assert_same(a.inverse() @ a, RigidTransform.identity())


@laws
@given(transforms, transforms)
def test_composition_maps_points_as_one_after_the_other(a, b):
    points = np.array([[[1.0, 2.0, 3.0], [-40.0, 0.5, 7.0]]])
    assert np.allclose((a @ b) @ points, a @ (b @ points), atol=1e-8)


@laws
@given(transforms)
def test_euler_angles_and_quaternions_return_the_same_rotation(a):
    again = RigidTransform.from_euler_xyz_rad(*a.euler_xyz_rad(), translation_mm=a.translation_mm)
    assert np.allclose(a.rotation, again.rotation, atol=1e-7)
    again = RigidTransform.from_quaternion_xyzw(a.quaternion_xyzw(), a.translation_mm)
    assert_same(a, again)
    assert a.quaternion_xyzw()[3] >= 0.0


def test_euler_angles_turn_about_fixed_axes_x_then_y_then_z():
    quarter = np.pi / 2
    x_to_z_to_minus_x = rotation_from_euler_xyz_rad(quarter, quarter, 0.0)
    # y -> z by the turn about x, then z -> x by the turn about the fixed y.
    assert np.allclose(x_to_z_to_minus_x @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    assert np.allclose(rotation_from_euler_xyz_rad(0, 0, quarter) @ [1, 0, 0], [0, 1, 0])


def test_holder_rotation_is_that_of_equation_22():
    c, s = np.cos(0.3), np.sin(0.3)
    assert np.array_equal(holder_rotation(0.3), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    assert np.allclose(holder_rotation(0.3), rotation_from_euler_xyz_rad(0, 0, -0.3))


def test_transforms_are_frozen():
    transform = RigidTransform.identity()
    with pytest.raises(ValueError, match="read-only"):
        transform.rotation[0, 0] = 2.0


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        (np.eye(3) * 1.01, np.zeros(3)),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3)),
        (np.full((3, 3), np.nan), np.zeros(3)),
        (np.eye(4), np.zeros(3)),
        (np.eye(3), [0.0, np.inf, 0.0]),
        (np.eye(3), [0.0, 0.0]),
    ],
)
def test_what_is_no_rigid_transform_is_refused(rotation, translation):
    with pytest.raises(InputError, match="Expected"):
        RigidTransform(rotation=rotation, translation_mm=translation)


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [1, 0, 0]])
def test_what_is_no_quaternion_is_refused(quaternion):
    with pytest.raises(InputError, match="quaternion"):
        RigidTransform.from_quaternion_xyzw(quaternion)


def test_points_of_the_wrong_shape_are_refused():
    with pytest.raises(InputError, match="shape"):
        RigidTransform.identity() @ np.zeros((3, 2))
