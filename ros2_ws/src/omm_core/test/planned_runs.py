"""Measurements by a plan on machines that err as declared: is its predicted U what they show?"""

from dataclasses import replace

import numpy as np

from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.circle import CircleCentre, project_circles
from omm_core.machine_errors import (
    draw_calibration,
    draw_geometry,
    draw_stop_noise,
    draw_targets,
    own_pose,
)
from omm_core.part_pose import Observation, SolveOptions, solve
from omm_core.planning.plan import Plan


def own_error(plan: Plan, random: np.random.Generator, *, near_mm: float = 3.0) -> np.ndarray:
    """Draw a machine, a part and a measurement of it; return the error of θ in own coordinates.

    The part lies within ``near_mm`` and 1 mrad of where the plan takes it to be.
    """
    scene = plan.scene
    noise = scene.noise
    turned = RigidTransform.from_euler_xyz_rad(*random.normal(0.0, 5e-4, 3))
    pose = scene.machine_T_part @ turned
    pose = replace(pose, translation_mm=pose.translation_mm + random.uniform(-1, 1, 3) * near_mm)
    gamma_s = scene.gamma_s_rad + random.uniform(-0.003, 0.003)
    spindles = [stop.machine_T_spindle for stop in plan.stops]
    places = np.array([s.translation_mm for s in spindles])
    geometry = draw_geometry(random, places, noise.geometry_sigma_mm, noise.geometry_length_mm)
    errors = geometry + draw_stop_noise(random, len(places), noise.stop_sigma_mm)
    true_part, true_camera = (
        draw_targets(random, scene.part), draw_calibration(random, scene.calibration),
    )  # fmt: skip
    rows = {target.id: row for row, target in enumerate(scene.part.targets)}
    stop_of = np.array([s for s, stop in enumerate(plan.stops) for _ in stop.target_ids])
    target_of = np.array([rows[t] for stop in plan.stops for t in stop.target_ids])
    centres = _centres(true_part, true_camera, target_of, stop_of, spindles, errors, pose, gamma_s)
    sigma = noise.image_sigma_px
    observations = [
        Observation(
            stamp_ns=(s + 1) * 1_000_000_000,
            target_id=scene.part.targets[t].id,
            center_px=centre + random.normal(0.0, sigma, 2),
            covariance_px2=np.eye(2) * sigma**2,
            machine_T_spindle=spindles[s],
        )
        for s, t, centre in zip(stop_of, target_of, centres)
    ]
    declared = SolveOptions(
        stop_sigma_mm=noise.stop_sigma_mm,
        geometry_sigma_mm=noise.geometry_sigma_mm,
        geometry_length_mm=noise.geometry_length_mm,
        find_errors=False,
    )
    solution = solve(observations, scene.part, scene.calibration, declared)
    X = np.array([target.xyz_mm for target in scene.part.targets])
    own = own_pose(pose, X, target_of, geometry[stop_of])
    truth = np.array([*own.euler_xyz_rad(), *own.translation_mm, gamma_s])
    return np.asarray(solution.theta - truth)


def normalised_squares(plan: Plan, runs: int, seed: int) -> np.ndarray:
    """Return eᵀ Q⁻¹ e of so many measurements with the plan's own Q; their mean should be 7."""
    scale = 1.0 / np.sqrt(np.diag(plan.covariance))
    inverse = np.linalg.inv(plan.covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    errors = [own_error(plan, np.random.default_rng([seed, run])) for run in range(runs)]
    return np.array([error @ inverse @ error for error in errors])


def _centres(part, camera, target_of, stop_of, spindles, errors, pose, gamma_s) -> np.ndarray:
    holder = spindle_T_taper(gamma_s) @ camera.taper_T_camera
    centres, normals = np.empty((2, len(target_of), 3))
    for k, (t, s) in enumerate(zip(target_of, stop_of)):
        true = replace(spindles[s], translation_mm=spindles[s].translation_mm + errors[s])
        camera_T_part = (true @ holder).inverse() @ pose
        centres[k] = camera_T_part @ part.targets[t].xyz_mm
        normals[k] = camera_T_part.rotation @ part.targets[t].normal
    diameters = [part.targets[t].dot_diameter_mm for t in target_of]
    return project_circles(camera.lens, centres, normals, diameters, CircleCentre.OUTLINE)
