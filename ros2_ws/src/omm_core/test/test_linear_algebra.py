"""The compiled Cholesky solvers against their definition, and what they refuse."""

import numpy as np
import pytest

from omm_core.numerics.linear_algebra import inverse, invert, solve_damped


@pytest.mark.parametrize("size", [1, 2, 7, 40])
def test_the_inverse_undoes_the_matrix_whatever_the_units(size):
    generator = np.random.default_rng(size)
    A = generator.normal(size=(size + 3, size)) * 10.0 ** generator.uniform(-6, 6, size)
    N = A.T @ A
    scale = np.sqrt(np.diag(N))
    undone = inverse(N) @ N * np.outer(scale, 1 / scale)
    assert np.allclose(undone, np.eye(size), atol=1e-9)


def test_the_inverse_is_symmetric_to_the_bit():
    A = np.random.default_rng(1).normal(size=(20, 7))
    Q = inverse(A.T @ A)
    assert np.array_equal(Q, Q.T)


@pytest.mark.parametrize("N", [np.ones((3, 3)), np.diag([1.0, -1.0]), np.full((2, 2), np.nan)])
def test_what_is_not_positive_definite_has_no_inverse(N):
    assert not invert(N, np.empty(N.shape))
    assert np.all(np.isnan(inverse(N)))


def test_singular_equations_are_told_and_damped_ones_solved():
    L, step = np.empty((7, 7)), np.zeros(7)
    N = np.diag([1.0, 2, 3, 4, 5, 6, 0])
    assert not solve_damped(N, np.ones(7), 7, 0.0, L, step)
    assert solve_damped(N, np.ones(7), 6, 0.0, L, step)
    assert np.allclose(step[:6], -1.0 / np.arange(1, 7))
    singular = np.ones((7, 7))
    assert not solve_damped(singular, np.ones(7), 7, 0.0, L, step)
    assert solve_damped(singular, np.ones(7), 7, 1.0, L, step)
    assert np.allclose((singular + np.eye(7)) @ step, -1.0)
