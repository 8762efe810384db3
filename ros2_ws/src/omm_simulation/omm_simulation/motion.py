"""How a machine moves: what is commanded, and how the machine follows.

A move runs along a straight line from rest to rest, limited in velocity, acceleration and jerk.
The machine follows the command as a linear system G: a first-order servo lag, and behind it the
structure, which swings at its natural frequency. All of it is a closed form in time: nothing is
integrated step by step, so that any time can be asked for in any order, with the same answer.

Response to a move. The command is made of steps of jerk Δj_k at the times t_k, each of which is
answered by Δj_k·(G/s⁴)(t − t_k). With G's Taylor coefficients g_m at s = 0, its poles p_i and the
residues c_i of G/s⁴ there, the sum over all steps is

    response(t) = Σ_m g_m · d^m/dt^m command(t) + Σ_i c_i Σ_k Δj_k exp(p_i (t − t_k)),  m = 0…3

(partial fractions; the polynomial part is again the command and its derivatives, which loses no
digits to cancellation).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Profile:
    """The way along a path of length 1, from rest to rest.

    Attributes
    ----------
    knots_s : ndarray, shape (8,)
        Where the jerk changes; from 0 to the duration.
    jerk_per_s3 : ndarray, shape (7,)
        Jerk between the knots, in path lengths per s³.
    """

    knots_s: Floats
    jerk_per_s3: Floats

    @property
    def duration_s(self) -> float:
        """How long the motion takes."""
        return float(self.knots_s[-1])

    @cached_property
    def jerk_steps_per_s3(self) -> Floats:
        """By how much the jerk changes at each knot, shape (8,)."""
        return np.diff(self.jerk_per_s3, prepend=0.0, append=0.0)

    @cached_property
    def _at_knots(self) -> Floats:
        """Position, velocity and acceleration at each knot, shape (8, 3)."""
        states = [np.zeros(3)]
        for duration, jerk in zip(np.diff(self.knots_s), self.jerk_per_s3):
            states.append(_advance(states[-1], jerk, duration)[:3])
        return np.array(states)

    def at(self, time_s: float) -> Floats:
        """Return position, velocity, acceleration and jerk, shape (4,), in path lengths and s."""
        if time_s < 0.0:
            return np.zeros(4)
        if time_s >= self.duration_s:
            return np.array([1.0, 0.0, 0.0, 0.0])
        k = int(np.searchsorted(self.knots_s, time_s, side="right")) - 1
        return _advance(self._at_knots[k], self.jerk_per_s3[k], time_s - self.knots_s[k])


def _advance(state: Floats, jerk: float, time_s: float) -> Floats:
    position, velocity, acceleration = state
    return np.array(
        [
            position + time_s * (velocity + time_s * (acceleration / 2 + time_s * jerk / 6)),
            velocity + time_s * (acceleration + time_s * jerk / 2),
            acceleration + time_s * jerk,
            jerk,
        ]
    )


def rest_to_rest(*, velocity: float, acceleration: float, jerk: float) -> Profile:
    """Return the fastest profile over a path of length 1 within the limits.

    Parameters
    ----------
    velocity, acceleration, jerk : float
        Limits in path lengths and seconds, all positive.
    """
    ramp_s, hold_s = _acceleration_phase(velocity, acceleration, jerk)
    accelerate_s = 2 * ramp_s + hold_s
    reached = jerk * ramp_s * (ramp_s + hold_s)
    cruise_s = max(0.0, 1.0 / reached - accelerate_s)
    durations = [ramp_s, hold_s, ramp_s, cruise_s, ramp_s, hold_s, ramp_s]
    return Profile(
        knots_s=np.concatenate([[0.0], np.cumsum(durations)]),
        jerk_per_s3=jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]),
    )


def _acceleration_phase(velocity: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """Return how long the jerk acts, and how long the acceleration then holds (both in s)."""
    ramp_s = min(acceleration / jerk, (velocity / jerk) ** 0.5)
    hold_s = max(0.0, velocity / (jerk * ramp_s) - ramp_s)
    if jerk * ramp_s * (ramp_s + hold_s) * (2 * ramp_s + hold_s) <= 1.0:
        return ramp_s, hold_s
    # The path is too short to reach the velocity: it is all speeding up and slowing down.
    ramp_s = min(acceleration / jerk, (1.0 / (2.0 * jerk)) ** (1.0 / 3.0))
    # 1 = j·T·(T + h)·(2T + h), solved for h.
    hold_s = (-3.0 * ramp_s + (ramp_s**2 + 4.0 / (jerk * ramp_s)) ** 0.5) / 2.0
    return ramp_s, max(0.0, hold_s)


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A machine's axes that follow their command with a lag, and swing.

    Attributes
    ----------
    lag_s : float
        Time constant of the servo.
    frequency_hz, damping : float
        Of the structure between what the control measures and the spindle; 0 Hz means rigid.
    """

    lag_s: float
    frequency_hz: float = 0.0
    damping: float = 0.1

    @cached_property
    def _poles(self) -> NDArray[np.complex128]:
        poles: list[complex] = [complex(-1.0 / self.lag_s)] if self.lag_s > 0.0 else []
        if self.frequency_hz > 0.0:
            omega = 2 * np.pi * self.frequency_hz
            swing = omega * (-self.damping + 1j * (1 - self.damping**2) ** 0.5)
            poles += [swing, swing.conjugate()]
        return np.array(poles)

    @cached_property
    def _expansion(self) -> tuple[Floats, NDArray[np.complex128]]:
        """Taylor coefficients g (4,) of G at 0, and the residues of G/s⁴ at the poles."""
        taylor = np.array([1.0 + 0j, 0.0, 0.0, 0.0])
        for pole in self._poles:  # divide by (1 − s/p): multiply by Σ (s/p)^m
            taylor = np.convolve(taylor, pole ** -np.arange(4.0))[:4]
        gain = np.prod(-self._poles)
        others = [np.prod(p - np.delete(self._poles, i)) for i, p in enumerate(self._poles)]
        return taylor.real, gain / (np.array(others) * self._poles**4)

    @cached_property
    def settled_s(self) -> float:
        """How long after the end of a move nothing (1e-15 of it) is left of it."""
        return float(35.0 / np.min(-self._poles.real)) if len(self._poles) else 0.0

    def response(self, profile: Profile, time_s: float) -> float:
        """Return how far along its path (1 = all of it) the machine is, a time after its start."""
        if time_s <= 0.0:
            return 0.0
        if time_s >= profile.duration_s + self.settled_s:
            return 1.0
        taylor, residues = self._expansion
        begun = slice(int(np.searchsorted(profile.knots_s, time_s, side="right")))
        steps = profile.jerk_steps_per_s3[begun]
        decayed = np.exp(self._poles[:, None] * (time_s - profile.knots_s[begun])) @ steps
        return float(taylor @ profile.at(time_s) + (residues @ decayed).real)
