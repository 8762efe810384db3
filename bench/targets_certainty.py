"""Wrong, missed and right numbers over the working range.

    ./omm exec python bench/targets_certainty.py [--draws 20000]

Dots of 8 to 120 px, tilts to 60°, contrasts from 20 DN, blur to 2 px, saturated or not, cut by the
border, both polarities, all families of 12 and 14 bit, amid machined metal with bright ellipses,
arcs, holes and letters. "Easy": dot 12 px or more, tilt to 50°, contrast 40 DN or more, not cut.
With --covered a chip or shadow lies on part of the ring; the set is one of `propose_ids`.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter

import numpy as np
from targets_speed import clutter

from omm_core.targets import DetectionOptions, TargetFamily, detect_targets
from omm_core.targets.coded.choosing import propose_ids
from omm_simulation.target_image import affine_plane, disc_coverage, target_coverage

FAMILIES = ("aicon12", "aicon14", "metashape12", "metashape14")


def scene(
    rng: np.random.Generator, backgrounds: list[np.ndarray], covered: bool, ids: dict[str, tuple]
) -> tuple[np.ndarray, TargetFamily, int, np.ndarray, bool]:
    """One image, its family, number and centre, and whether it is easy."""
    family = TargetFamily.by_name(FAMILIES[int(rng.integers(4))])
    target_id = int(rng.choice(ids[family.name]))
    diameter = float(np.exp(rng.uniform(math.log(8.0), math.log(120.0))))
    tilt = rng.uniform(0, math.radians(60.0))
    contrast = float(np.exp(rng.uniform(math.log(20.0), math.log(400.0))))
    blur = rng.uniform(0.4, 2.0)
    radius = 0.5 * diameter
    reach = (family.ring_outer_ratio + 0.5) * radius
    size = int(min(2.0 * reach + 60.0, 640.0))
    cut = rng.random() < 0.1
    inside = reach + 3.0
    centre = rng.uniform(inside, max(size - inside, inside + 1.0), 2)
    if cut:
        centre[int(rng.integers(2))] = rng.uniform(-0.5, 1.0) * reach
    plane = affine_plane(
        centre_px=tuple(centre), radius_px=radius, tilt_rad=tilt, axis_rad=rng.uniform(0, math.pi)
    )
    window = (0, 0, size, size)
    cells = 2 if diameter > 30.0 else 4
    cover = target_coverage(
        code=family.code_of(target_id),
        family=family,
        dot_radius_mm=1.0,
        plane_of_pixel=plane,
        window=window,
        blur_px=blur,
        cells=cells,
        phase_rad=rng.uniform(0, 7),
    )
    label = disc_coverage(
        centre_mm=(0, 0),
        radius_mm=family.ring_outer_ratio + 0.5,
        cells=2,
        plane_of_pixel=plane,
        window=window,
        blur_px=blur,
    )
    ground = backgrounds[int(rng.integers(len(backgrounds)))]
    top, left = (int(rng.integers(0, side - size)) for side in ground.shape)
    image = ground[top : top + size, left : left + size]
    dark = rng.uniform(5.0, 40.0)
    image = image * (1 - label) + (dark + contrast * cover) * label
    if covered:
        angle, middle = rng.uniform(0, 2 * math.pi), family.read_ratio
        chip = disc_coverage(
            centre_mm=(middle * math.cos(angle), middle * math.sin(angle)),
            cells=2,
            radius_mm=rng.uniform(0.4, 1.3),
            plane_of_pixel=plane,
            window=window,
            blur_px=blur,
        )
        level = rng.choice([dark, dark + contrast, rng.uniform(0, 255)])
        image = image * (1 - chip) + level * chip
    if rng.random() < 0.3:
        image = np.clip(255.0 - np.minimum(image, 255.0), 0, 255)
    image = image + rng.normal(size=image.shape) * np.sqrt(4.0 + 0.05 * np.maximum(image, 0.0))
    pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    easy = not cut and diameter >= 12.0 and tilt <= math.radians(50.0) and contrast >= 40.0
    return pixels, family, target_id, centre, easy


def count(draws: int, *, covered: bool = False, chosen: int = 0, seed: int = 1) -> Counter[str]:
    """Count what becomes of `draws` renderings; `chosen` > 0 draws from a proposed set only."""
    rng = np.random.default_rng(seed)
    backgrounds = [clutter((1000, 1000), rng) for _ in range(6)]
    families = {name: TargetFamily.by_name(name) for name in FAMILIES}
    ids = {
        name: propose_ids(family, chosen).ids if chosen else tuple(range(1, len(family) + 1))
        for name, family in families.items()
    }
    result: Counter[str] = Counter()
    for _ in range(draws):
        image, family, target_id, centre, easy = scene(rng, backgrounds, covered, ids)
        targets = detect_targets(image, family, DetectionOptions()).targets
        right = any(
            t.id == target_id and math.dist(t.center_px, centre) < 0.3 * t.diameter_px
            for t in targets
        )
        wrong = [t for t in targets if t.id != target_id]
        result["draws"] += 1
        result["right"] += right
        result["wrong"] += bool(wrong)
        result["wrong in set"] += any(t.id in ids[family.name] for t in wrong)
        result["easy"] += easy
        result["easy right"] += easy and right
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    print("| scene | images | wrong numbers | of the set | right | right where easy |")
    print("|---|---|---|---|---|---|")
    for name, covered, chosen in (
        ("nothing covered, whole family", False, 0),
        ("ring partly covered, whole family", True, 0),
        ("ring partly covered, 10 proposed numbers", True, 10),
    ):
        draws = args.draws if not covered else max(args.draws // 4, 1)
        r = count(draws, covered=covered, chosen=chosen, seed=args.seed)
        print(
            f"| {name} | {r['draws']} | {r['wrong']} | {r['wrong in set']} "
            f"| {100 * r['right'] / r['draws']:.1f} % "
            f"| {100 * r['easy right'] / max(r['easy'], 1):.2f} % of {r['easy']} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
