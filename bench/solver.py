"""The 7D solver beside scipy, pyceres and gtsam, in one run.

    ./omm exec python bench/solver.py [--cells 10000] [--quick]

The peers solve the same problem with the same model in vectorised numpy, analytic derivatives
and a cost function each calls once an iteration. Times are CPU times of this process, medians.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path[:0] = [
    str(Path(__file__).resolve().parents[1] / "ros2_ws/src/omm_core" / folder)
    for folder in ("", "test")
]

from core_cells import bench_cell, random_cell  # noqa: E402

from omm_core.geometry import holder_rotation, rotation_from_euler_xyz_rad  # noqa: E402
from omm_core.numerics.linear_algebra import inverse  # noqa: E402
from omm_core.part_pose import SolveOptions, build_problem, solve  # noqa: E402
from omm_core.part_pose.adjustment import (  # noqa: E402
    MAX_ITERATIONS,
    TOLERANCE_SIGMA,
    Adjustment,
    adjust,
    refine,
)
from omm_core.part_pose.gauss_newton import gauss_newton  # noqa: E402
from omm_core.part_pose.model import State  # noqa: E402
from omm_core.part_pose.monte_carlo import solve_each  # noqa: E402
from omm_core.part_pose.noise_model import noise_model  # noqa: E402
from omm_core.part_pose.posterior import posterior  # noqa: E402

SIGMA_PX = 0.05
REPLICATES = 10_000
OPTIONS = SolveOptions(
    find_errors=False, stop_sigma_mm=0.0, geometry_sigma_mm=0.0, trust_detector=True
)


class PaperModel:
    """Residuals and Jacobian of the paper (points) by θ, vectorised numpy, whitened."""

    def __init__(self, problem):
        self.lens = problem.calibration.lens
        self.R_calib, self.d_calib = problem.R_calib, problem.d_calib
        self.R_cnc, self.d_cnc = problem.R_cnc[problem.image_of], problem.d_cnc[problem.image_of]
        self.X = problem.points[problem.target_of, 0] + problem.X0_mm
        self.measured = problem.measured
        self.f = self.lens.principal_distance_px

    def __call__(self, theta):
        """Return residuals (2N,) and the Jacobian (2N, 7)."""
        a, b, g = theta[:3]
        R = rotation_from_euler_xyz_rad(a, b, g)
        turned = self.X @ R.T
        R_s = holder_rotation(theta[6])
        A = np.swapaxes(self.R_cnc @ (R_s @ self.R_calib), 1, 2)
        q = np.einsum("nji,nj->ni", self.R_cnc, turned + theta[3:6] - self.d_cnc)
        U = (q @ R_s - self.d_calib) @ self.R_calib
        pixels, D_p = self.pixels(U)
        c, s = np.cos(theta[6]), np.sin(theta[6])
        D_s = np.array([[-s, c, 0.0], [-c, -s, 0.0], [0.0, 0.0, 0.0]])
        # ω = E dangles: the turns' axes
        E = np.array([
            [np.cos(g) * np.cos(b), -np.sin(g), 0.0],
            [np.sin(g) * np.cos(b), np.cos(g), 0.0],
            [-np.sin(b), 0.0, 1.0],
        ])  # fmt: skip
        by_machine = D_p @ A
        J = np.empty((len(U), 2, 7))
        J[:, :, :3] = by_machine @ np.cross(E.T[None], turned[:, None, :]).transpose(0, 2, 1)
        J[:, :, 3:6] = by_machine
        J[:, :, 6] = np.einsum("nij,nj->ni", D_p, q @ D_s @ self.R_calib)
        r = (pixels - self.measured) / SIGMA_PX
        return r.ravel(), J.reshape(-1, 7) / SIGMA_PX

    def pixels(self, U):
        """Return pixels (N, 2) and d(pixel)/dU (N, 2, 3): Brown by four Newton steps, no checks."""
        lens, w = self.lens, U[:, 2]
        k1, k2, p1, p2, f = lens.k1_px2, lens.k2_px4, lens.p1_px, lens.p2_px, self.f
        u, v = f * U[:, 0] / w, f * U[:, 1] / w
        x, y = u, v
        for _ in range(4):
            r2 = x * x + y * y
            scale, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2)
            error_x = u - x * scale - p1 * (r2 + 2 * x * x) - 2 * p2 * x * y
            error_y = v - y * scale - p2 * (r2 + 2 * y * y) - 2 * p1 * x * y
            xx = scale + slope * x * x + 6 * p1 * x + 2 * p2 * y
            yy = scale + slope * y * y + 6 * p2 * y + 2 * p1 * x
            xy = slope * x * y + 2 * p1 * y + 2 * p2 * x
            h = 1.0 / (xx * yy - xy * xy)
            x, y = x + h * (yy * error_x - xy * error_y), y + h * (xx * error_y - xy * error_x)
        D = np.empty((len(U), 2, 3))
        h = h * f / w
        D[:, 0, 0], D[:, 1, 1] = h * yy, h * xx
        D[:, 0, 1] = D[:, 1, 0] = -h * xy
        D[:, :, 2] = -(
            D[:, :, :1] * (u / f)[:, None, None] + D[:, :, 1:2] * (v / f)[:, None, None]
        )[:, :, 0]
        return np.stack([x, y], axis=1) + lens.principal_point_px, D


def with_scipy(model):
    """Return θ by scipy's Levenberg-Marquardt."""
    from scipy.optimize import least_squares

    scale = np.array([1e-3] * 3 + [1.0] * 3 + [1e-3])
    return least_squares(
        lambda t: model(t)[0], np.zeros(7), jac=lambda t: model(t)[1], method="lm",
        x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14,
    ).x  # fmt: skip


def with_pyceres(model):
    """Return θ by Ceres through pyceres: one cost function for all."""
    import pyceres

    class Cost(pyceres.CostFunction):
        def __init__(self):
            super().__init__()
            self.set_num_residuals(2 * len(model.X))
            self.set_parameter_block_sizes([7])

        def Evaluate(self, parameters, residuals, jacobians):
            r, J = model(parameters[0])
            residuals[:] = r
            if jacobians is not None:
                jacobians[0][:] = J.ravel()
            return True

    theta, problem, cost = np.zeros(7), pyceres.Problem(), Cost()
    problem.add_residual_block(cost, None, [theta])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_QR
    options.num_threads, options.minimizer_progress_to_stdout = 1, False
    options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 1e-14
    pyceres.solve(options, problem, pyceres.SolverSummary())
    return theta


def with_gtsam(model):
    """Return θ by gtsam: one CustomFactor for all."""
    import gtsam

    def error(this, values, jacobians):
        r, J = model(values.atVector(this.keys()[0]))
        if jacobians is not None:
            jacobians[0] = J
        return r

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Unit.Create(2 * len(model.X))
    graph.add(gtsam.CustomFactor(noise, [0], error))
    values.insert(0, np.zeros(7))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    return optimiser.optimize().atVector(0)


def at_zero(problem):
    """Return θ = 0, where all solvers start."""
    return Adjustment(
        rotation=np.eye(3), d0_mm=problem.X0_mm.copy(), gamma_s_rad=0.0, cost=0.0,
        normal=np.zeros((7, 7)), converged=True, iterations=0,
    )  # fmt: skip


def gauss_newton_of(problem, *, circles):
    """Return a function that solves from θ = 0, with covariance."""
    model, seen = problem.model(circles=circles), problem.seen

    def run():
        state, N = State(np.eye(3), problem.X0_mm.copy(), np.zeros(1)), np.empty((7, 7))
        gauss_newton(model, seen, 7, MAX_ITERATIONS, TOLERANCE_SIGMA, state, N)
        return state, inverse(N)

    return run


def with_unknown_noise(problem):
    """Return the pose, with U and the machine's noise, solved from θ = 0 (with circles)."""
    options = SolveOptions()
    estimated = posterior(noise_model(problem, refine(problem, options, at_zero(problem)), options),
                          options)  # fmt: skip
    return estimated.statement(own=True), estimated.statement(own=False)


def cpu_seconds(function, repeats):
    """Return the median CPU time of a call; short calls are timed in batches."""
    function()
    times = []
    for _ in range(repeats):
        batch, begin = 0, time.process_time()
        while batch == 0 or time.process_time() - begin < 0.02:
            function()
            batch += 1
        times.append((time.process_time() - begin) / batch)
    return float(np.median(times))


def compare_with_peers(problem):
    """Print time and agreement of one solve of the paper's problem from θ = 0."""
    model = PaperModel(problem)
    paper = replace(problem, circles=problem.points)
    reference = refine(paper, OPTIONS, at_zero(paper)).theta(problem.X0_mm)
    print("one 7D solve of 8 observations from θ = 0 (paper's model: points)\n")
    print(f"{'':38}{'µs':>10}{'of pyceres':>12}{'largest |θ - omm|':>20}")
    times = {}
    for name, peer in (("scipy", with_scipy), ("pyceres", with_pyceres), ("gtsam", with_gtsam)):
        try:
            off = np.abs(peer(model) - reference).max()
        except ImportError:
            print(f"{name:38}{'not installed':>22}")
            continue
        times[name] = cpu_seconds(lambda peer=peer: peer(model), 9)
        times.setdefault("pyceres", np.nan)
        print(f"{name:38}{1e6 * times[name]:10.1f}{'':12}{off:20.1e}")
    ours = {
        "omm, with covariance": gauss_newton_of(paper, circles=False),
        "omm with circles and covariance": gauss_newton_of(problem, circles=True),
        "omm, unknown noise, own and absolute": lambda: with_unknown_noise(problem),
        "omm from nothing, all starts": lambda: adjust(problem, OPTIONS),
    }
    for name, function in ours.items():
        seconds = cpu_seconds(function, 9)
        times_faster = times.get("pyceres", np.nan) / seconds
        ratio = f"1/{times_faster:.0f}" if times_faster > 10 else f"1/{times_faster:.1f}"
        print(f"{name:38}{1e6 * seconds:10.1f}{ratio:>12}")
    return times


def compare_monte_carlo(problem, pyceres_seconds):
    """Print the time of 10,000 replicates, and Monte Carlo against the linear covariance."""
    random = np.random.default_rng(1)
    truth = adjust(problem, OPTIONS)[0]
    noise = random.normal(0.0, SIGMA_PX, (REPLICATES, *problem.measured.shape))
    measured = problem.measured + noise
    print(f"\n{REPLICATES} Monte Carlo replicates\n")
    zero = at_zero(problem)
    for circles in (False, True):
        base = problem if circles else replace(problem, circles=problem.points)
        seconds = cpu_seconds(lambda b=base: solve_each(b, OPTIONS, measured, zero), 1)
        peer = pyceres_seconds * REPLICATES
        name = "circles" if circles else "points"
        ratio = f"1/{peer / seconds:.0f} of pyceres ({REPLICATES} solves: {peer:.1f} s)"
        print(f"omm, {name:10}{seconds:8.3f} s   {ratio}")
    _, translations, gammas, failed = solve_each(problem, OPTIONS, measured, truth)
    sigma = np.sqrt(np.diag(np.linalg.inv(truth.normal)))
    ratios = [*(translations.std(axis=0) / sigma[3:6]), gammas.std() / sigma[6]]
    print(
        f"deviation / linear covariance of d_0 and γ_s: {np.round(ratios, 3).tolist()};"
        f" {failed} did not converge"
    )


def compare_sizes(problem, largest):
    """Print the time by the number of observations."""
    print("\ncost by observations (points, from θ = 0, with covariance)\n")
    for copies in (1, 5, 25, 125, 1250, 12_500, 125_000):
        if 8 * copies > largest:
            break
        many = replace(
            problem,
            circles=problem.points,
            image_of=np.repeat(problem.image_of, copies),
            target_of=np.repeat(problem.target_of, copies),
            measured=np.repeat(problem.measured, copies, axis=0),
            information=np.repeat(problem.information, copies, axis=0),
        )
        seconds = cpu_seconds(gauss_newton_of(many, circles=False), 3)
        count = 8 * copies
        print(f"{count:9} {1e3 * seconds:10.3f} ms   {1e9 * seconds / count:8.1f} ns each")


def try_cells(count):
    """Print how many random cells reach the optimum that a solver started at the truth finds."""
    random = np.random.default_rng(1)
    missed, seconds = [], 0.0
    for number in range(count):
        cell = random_cell(random)
        options = replace(OPTIONS, model="6d" if number % 4 == 0 else "7d",
                          gamma_s_rad=cell.gamma_s_rad)  # fmt: skip
        problem = build_problem(cell.noisy(random, SIGMA_PX), cell.part, cell.calibration)
        begin = time.process_time()
        found = adjust(problem, options)
        seconds += time.process_time() - begin
        truth = replace(
            at_zero(problem), rotation=cell.machine_T_part.rotation,
            d0_mm=cell.machine_T_part @ problem.X0_mm, gamma_s_rad=cell.gamma_s_rad,
        )  # fmt: skip
        best = refine(problem, options, truth)
        if not (
            found and found[0].converged and found[0].cost <= best.cost * (1 + 1e-7)
            and np.abs(found[0].rotation - best.rotation).max() < 1e-8
        ):  # fmt: skip
            missed.append(number)
    print(
        f"\n{count} random cells from nothing: {len(missed)} missed the optimum found from the"
        f" truth{f' (numbers {missed})' if missed else ''};"
        f" {1e3 * seconds / max(count, 1):.1f} ms each"
    )


def main():
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=0, help="random cells to try (0)")
    parser.add_argument("--quick", action="store_true", help="up to 10,000 observations only")
    arguments = parser.parse_args()
    random = np.random.default_rng(6)
    cell = bench_cell(random)
    problem = build_problem(cell.noisy(random, SIGMA_PX), cell.part, cell.calibration)
    solve(problem.observations, cell.part, cell.calibration)  # compile or load
    times = compare_with_peers(problem)
    compare_monte_carlo(problem, times.get("pyceres", np.nan))
    compare_sizes(problem, 10_000 if arguments.quick else 1_000_000)
    if arguments.cells:
        try_cells(arguments.cells)


if __name__ == "__main__":
    main()
