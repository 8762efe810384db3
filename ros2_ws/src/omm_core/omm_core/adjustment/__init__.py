"""The general least-squares adjustment: cameras, stations, points, each free, fixed or observed.

A problem is a number of *groups* of unknowns and of *blocks* of observations::

    problem = Problem(
        groups=(
            Group(name="lens", values=lens),                      # (1, 10), free
            Group(name="photos", values=poses),                   # (P, 6), free
            Group(name="points", values=xyz, sigma=sigma_xyz),    # (T, 3), observed
        ),
        blocks=(
            Block(
                name="rays", observed=pixels, covariance=cov,     # (M, 2), (M, 2, 2)
                index={"lens": zeros, "photos": photo_of_ray, "points": point_of_ray},
                evaluate=predict,
            ),
        ),
        datum={"points": rigid_directions(xyz)},                  # leave out where not needed
    )
    solution = solve(problem)
    tests = test_observations(problem, solution)

``evaluate(values)`` takes the groups' values by name and returns the predicted observations (M, d)
and, by group, the derivative (M, d, k) by the one row of the group that each observation sees.
A scale bar is a block with d = 1 that sees ``points`` twice: index keys of the form ``"points:2"``
are a second reference to the same group (anything after the colon tells them apart).

``Group.held`` keeps single values as they are; ``sigma`` (inf where not observed) or
``covariance`` makes a group observed; a Group with ``fixed=True`` is not adjusted at all. A group
whose values do not add up (rotations) gives ``update(values, step)``.

``solve`` is Gauss-Newton with Levenberg's damping where a step would not improve. The normal
equations are dense and scaled to a unit diagonal: a few thousand unknowns. A free network has
``datum``: the inner constraints Gᵀ dx = 0 over the rows of some groups, by N + G Gᵀ; the
covariance is that of this datum. Directions that neither observations nor datum settle are found by
the algebra (:class:`Undetermined`) and left where they started; their covariance is infinite in
meaning, and ``Solution.undetermined`` must be asked before ``covariance`` is believed.
The covariance is a priori (sigma0 = 1): multiply it by ``solution.sigma0**2`` where the
observations' own covariance is a weight rather than the truth.
"""

from omm_core.adjustment.datum import rigid_directions, similarity_directions
from omm_core.adjustment.problem import Block, Group, Problem
from omm_core.adjustment.solving import Solution, Undetermined, solve
from omm_core.adjustment.statistics import ObservationTests, test_observations

__all__ = [
    "Block",
    "Group",
    "ObservationTests",
    "Problem",
    "Solution",
    "Undetermined",
    "rigid_directions",
    "similarity_directions",
    "solve",
    "test_observations",
]
