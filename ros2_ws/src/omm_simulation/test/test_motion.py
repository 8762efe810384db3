"""Laws of moves and of how the machine follows them."""

import numpy as np
import pytest

from omm_simulation.motion import Follower, rest_to_rest

LIMITS = [(1, 2, 20), (0.1, 2, 20), (10, 2, 20), (10, 20, 20), (0.5, 10, 3)]


def sampled(profile, count=4001):
    times = np.linspace(0.0, profile.duration_s, count)
    return times, np.array([profile.at(t) for t in times])


@pytest.mark.parametrize(("velocity", "acceleration", "jerk"), LIMITS)
def test_a_move_starts_and_ends_at_rest(velocity, acceleration, jerk):
    profile = rest_to_rest(velocity=velocity, acceleration=acceleration, jerk=jerk)
    np.testing.assert_allclose(profile.at(0.0)[:3], [0.0, 0.0, 0.0], atol=1e-12)
    just_before = profile.at(profile.duration_s * (1 - 1e-12))
    np.testing.assert_allclose(just_before[:3], [1.0, 0.0, 0.0], atol=1e-9)
    assert profile.at(profile.duration_s + 1.0)[0] == 1.0


@pytest.mark.parametrize(("velocity", "acceleration", "jerk"), LIMITS)
def test_a_move_keeps_its_limits_and_uses_one_of_them_fully(velocity, acceleration, jerk):
    profile = rest_to_rest(velocity=velocity, acceleration=acceleration, jerk=jerk)
    _, states = sampled(profile)
    used = np.abs(states[:, 1:]).max(axis=0) / [velocity, acceleration, jerk]
    assert np.all(used <= 1.0 + 1e-9)
    assert used.max() > 0.999


@pytest.mark.parametrize(("velocity", "acceleration", "jerk"), LIMITS)
def test_velocity_and_acceleration_are_the_derivatives_of_position(velocity, acceleration, jerk):
    profile = rest_to_rest(velocity=velocity, acceleration=acceleration, jerk=jerk)
    times, states = sampled(profile)
    step_s = times[1] - times[0]
    # What central differences miss: at most j·h²/3 of the velocity, and j·h/2 where the jerk jumps.
    missed = (jerk * step_s**2 / 3, jerk * step_s / 2)
    for order in (0, 1):
        numeric = np.gradient(states[:, order], times)[2:-2]
        error = np.abs(numeric - states[2:-2, order + 1]).max()
        assert error <= missed[order] * 1.001 + 1e-9


@pytest.mark.parametrize("follower", [
    Follower(lag_s=0.02),
    Follower(lag_s=0.03, frequency_hz=25.0, damping=0.1),
    Follower(lag_s=0.0, frequency_hz=10.0, damping=0.3),
], ids=["lag", "lag and structure", "structure"])  # fmt: skip
def test_the_closed_form_of_the_response_agrees_with_step_by_step_integration(follower):
    from scipy import signal

    profile = rest_to_rest(velocity=1.0, acceleration=3.0, jerk=30.0)
    times = np.linspace(0.0, profile.duration_s + 1.0, 20001)
    denominator = np.array([follower.lag_s, 1.0]) if follower.lag_s else np.array([1.0])
    if follower.frequency_hz:
        omega = 2 * np.pi * follower.frequency_hz
        structure = [1 / omega**2, 2 * follower.damping / omega, 1.0]
        denominator = np.polymul(denominator, structure)
    command = np.array([profile.at(t)[0] for t in times])
    _, integrated, _ = signal.lsim(([1.0], denominator), command, times)
    response = np.array([follower.response(profile, t) for t in times[::50]])
    np.testing.assert_allclose(response, integrated[::50], atol=1e-7)


def test_a_rigid_machine_without_lag_is_where_it_is_commanded():
    profile = rest_to_rest(velocity=1.0, acceleration=3.0, jerk=30.0)
    rigid = Follower(lag_s=0.0)
    for time_s in np.linspace(0.01, profile.duration_s, 17):
        assert rigid.response(profile, time_s) == pytest.approx(profile.at(time_s)[0], abs=1e-15)
