"""Centres of dots against the Cramér–Rao bound: RMSE, bias and covariance.

    ./omm exec python bench/targets_accuracy.py [--draws 1000]

The bound is that of the centre of a blurred ellipse whose centre, shape, size, blur and two grey
levels are unknown, in the pixels up to halfway to the ring; rendered with exact areas at another
place within the pixel in every draw. It knows nothing of slopes of light.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np

from omm_core.targets import DetectionOptions, TargetFamily, detect_targets
from omm_simulation.target_image import affine_plane, disc_coverage, target_coverage


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of image."""

    name: str
    diameter_px: float
    tilt_deg: float = 0.0
    blur_px: float = 0.8
    read_dn: float = 2.0
    gain: float = 0.0
    slope: float = 0.0
    level_dn: float = 165.0
    contrast_dn: float = 150.0
    edge: bool = False
    family: str = "metashape12"


CASES = (
    *(Case(name=f"{d} px", diameter_px=d) for d in (12, 20, 40, 60, 120)),
    *(Case(name=f"{d} px, shot noise", diameter_px=d, gain=0.1) for d in (12, 20, 60)),
    *(Case(name=f"{d} px, blur 0.5", diameter_px=d, blur_px=0.5) for d in (12, 20, 60)),
    *(Case(name=f"{d} px, blur 1.5", diameter_px=d, blur_px=1.5) for d in (12, 20, 60)),
    *(Case(name=f"{d} px, tilt 45", diameter_px=d, tilt_deg=45.0) for d in (20, 60)),
    *(Case(name=f"{d} px, tilt 60", diameter_px=d, tilt_deg=60.0) for d in (20, 60)),
    *(Case(name=f"{d} px, light falls 10 %", diameter_px=d, slope=0.1) for d in (12, 20, 60, 120)),
    *(Case(name=f"{d} px, saturated", diameter_px=d, contrast_dn=400.0) for d in (12, 20, 60)),
    *(Case(name=f"{d} px, bright edge beside", diameter_px=d, edge=True) for d in (12, 20, 60)),
    *(Case(name=f"{d} px, aicon12", diameter_px=d, family="aicon12") for d in (12, 20, 60)),
)


def draw(case: Case, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One clean image (DN) and the true centre (px)."""
    family = TargetFamily.by_name(case.family)
    radius = 0.5 * case.diameter_px
    size = 2 * math.ceil((family.ring_outer_ratio + (2.0 if case.edge else 0.8)) * radius + 8)
    centre = 0.5 * size + rng.uniform(-0.5, 0.5, 2)
    plane = affine_plane(
        centre_px=tuple(centre),
        radius_px=radius,
        tilt_rad=math.radians(case.tilt_deg),
        axis_rad=rng.uniform(0, math.pi),
    )
    common = {
        "family": family,
        "code": family.code_of(int(rng.integers(1, len(family) + 1))),
        "dot_radius_mm": 1.0,
        "plane_of_pixel": plane,
        "window": (0, 0, size, size),
        "blur_px": case.blur_px,
        "phase_rad": rng.uniform(0, 6.283),
    }
    cover = target_coverage(**common)
    light = np.ones((size, size))
    if case.edge:
        # A bright disc, large enough to be an edge, one dot radius beyond the ring.
        angle = rng.uniform(0, 2 * math.pi)
        far = (8.0 + family.ring_outer_ratio + 1.0) * radius
        cover = cover + disc_coverage(
            centre_mm=(far * math.cos(angle), far * math.sin(angle)),
            radius_mm=8.0 * radius,
            plane_of_pixel=lambda c, r: (c - centre[0], r - centre[1]),
            window=(0, 0, size, size),
            blur_px=case.blur_px,
        )
    if case.slope:
        angle = rng.uniform(0, 2 * math.pi)
        rows, cols = np.mgrid[:size, :size]
        along = (cols - centre[0]) * math.cos(angle) + (rows - centre[1]) * math.sin(angle)
        light = 1.0 + case.slope * along / case.diameter_px
    low = case.level_dn - 150.0
    return light * (low + case.contrast_dn * cover), centre


def bound_px2(case: Case, centre: np.ndarray, rng: np.random.Generator) -> float:
    """Mean of the bound's two variances, from numeric derivatives of the rendered dot."""
    family = TargetFamily.by_name(case.family)
    radius = 0.5 * case.diameter_px
    size = 2 * math.ceil((family.ring_outer_ratio + 0.8) * radius + 8)
    axis = rng.uniform(0, math.pi)

    def render(p: np.ndarray) -> np.ndarray:
        plane = affine_plane(centre_px=(p[0], p[1]), radius_px=p[2], tilt_rad=p[3], axis_rad=p[4])
        cover = disc_coverage(
            centre_mm=(0, 0),
            radius_mm=1.0,
            plane_of_pixel=plane,
            window=(0, 0, size, size),
            blur_px=p[5],
        )
        return p[6] + p[7] * cover

    tilt = math.radians(max(case.tilt_deg, 3.0))
    p0 = np.array(
        [*centre, radius, tilt, axis, case.blur_px, case.level_dn - 150.0, case.contrast_dn]
    )
    steps = np.array([1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-2, 1.0, 1.0])
    columns = []
    for i, step in enumerate(steps):
        if i in (3, 4) and case.tilt_deg == 0.0:
            continue  # of a circle: the shape is uncorrelated with the centre
        shift = np.zeros(8)
        shift[i] = step
        columns.append(((render(p0 + shift) - render(p0 - shift)) / (2 * step)).ravel())
    mean = render(p0).ravel()
    weight = 1.0 / (case.read_dn**2 + case.gain * mean + 1.0 / 12.0)
    weight[mean > 255.0 - 0.5 * case.read_dn] = 0.0
    jacobian = np.array(columns).T
    covariance = np.linalg.inv(jacobian.T @ (jacobian * weight[:, None]))
    return 0.5 * float(covariance[0, 0] + covariance[1, 1])


def run_case(case: Case, draws: int, seed: int = 1) -> dict[str, float]:
    """RMSE, bias and mean normalised squared error over the draws."""
    rng = np.random.default_rng(seed)
    family = TargetFamily.by_name(case.family)
    errors, normalised, bounds = [], [], []
    for index in range(draws):
        clean, centre = draw(case, rng)
        noise = rng.normal(size=clean.shape) * np.sqrt(case.read_dn**2 + case.gain * clean)
        image = np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)
        targets = detect_targets(image, family, DetectionOptions()).targets
        if index < 6:
            bounds.append(bound_px2(case, centre, rng))
        if len(targets) != 1:
            continue
        error = targets[0].center_px - centre
        errors.append(error)
        normalised.append(error @ np.linalg.solve(targets[0].covariance_px2, error))
    e = np.array(errors).reshape(-1, 2)
    return {
        "found": len(e) / draws,
        "rmse": float(np.sqrt(np.mean(e**2))),
        "bound": float(np.sqrt(np.mean(bounds))),
        "bias": float(np.abs(e.mean(axis=0)).max()),
        "nees": float(np.mean(normalised)),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    print(f"{args.draws} draws each; RMSE per axis and bias in 10⁻³ px; NEES should be 2")
    print("| image | bound | RMSE | RMSE / bound | bias | NEES | found |")
    print("|---|---|---|---|---|---|---|")
    for seed, case in enumerate(CASES):
        if args.only not in case.name:
            continue
        r = run_case(case, args.draws, seed)
        print(
            f"| {case.name} | {1e3 * r['bound']:.2f} | {1e3 * r['rmse']:.2f} "
            f"| {r['rmse'] / r['bound']:.3f} | {1e3 * r['bias']:.2f} | {r['nees']:.2f} "
            f"| {100 * r['found']:.1f} % |",
            flush=True,
        )


if __name__ == "__main__":
    main()
