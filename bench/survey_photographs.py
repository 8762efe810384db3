"""Draw a survey: photographs of a block with coded and plain targets, two bars and a check bar.

    ./omm exec python bench/survey_photographs.py FOLDER [--photos 40 --width_px 4288 ...]
    time ./omm survey FOLDER                           # 40 photographs of 12 MP: at most 30 s
    ./omm exec python bench/survey_photographs.py --check FOLDER RESULT.json

The truth is written beside the photographs (truth.json); `--check` compares a result with it.
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import lens_pixels, undistorted
from omm_core.targets import TargetFamily
from omm_simulation.target_image import target_coverage

Array = NDArray[np.float64]

_STEEPEST = np.cos(np.radians(70.0))
_DARK, _LABEL, _BRIGHT = 9.0, 2.0, 170.0
_BLUR_PX, _NOISE_DN = 0.7, 1.0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is drawn; lengths in mm."""

    photos: int = 40
    coded: int = 41
    plain: int = 79
    length: float = 1500.0
    width: float = 1000.0
    height: float = 500.0
    distance: float = 2.3  # times the length
    coded_dot: float = 10.0
    plain_dot: float = 8.0
    width_px: int = 4288
    height_px: int = 2848
    focal_px: float = 4400.0
    family: str = "aicon12"
    bar_sigma: float = 0.004
    suffix: str = ".jpg"
    seed: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """A target: its number (0: plain), place, and axes (columns x, y, outward normal)."""

    number: int
    place: Array
    axes: Array
    radius: float


def targets_of(plan: Plan, rng: np.random.Generator) -> tuple[list[Target], list[dict[str, Any]]]:
    """Return the targets of the block and of the bars, and the bars as survey.yaml has them."""
    size = np.array([plan.length, plan.width, plan.height])
    ids = [int(i) for i in rng.permutation(len(TargetFamily.by_name(plan.family)))[: plan.coded]]
    ids = [i + 1 for i in ids]
    targets: list[Target] = []
    bars = []
    for k, share in enumerate((0.93, 0.73, 0.6)):
        y = (-0.2, 1.2, -0.35)[k] * plan.width
        length = share * plan.length
        ends = []
        for x in (0.02 * plan.length, 0.02 * plan.length + length):
            number = ids.pop()
            ends.append(number)
            place = np.array([x, y, 0.1 * plan.height])
            targets.append(
                Target(number=number, place=place, axes=np.eye(3), radius=0.5 * plan.coded_dot)
            )
        measured = length + rng.normal(0.0, plan.bar_sigma)
        bars.append({"ends": ends, "length_mm": measured, "sigma_mm": plan.bar_sigma})
    kinds = [(n, 0.5 * plan.coded_dot) for n in ids] + [(0, 0.5 * plan.plain_dot)] * plan.plain
    areas = np.array([size[0] * size[1], *[size[0] * size[2]] * 2, *[size[1] * size[2]] * 2])
    for number, radius in kinds:
        for _ in range(1000):
            face = int(rng.choice(5, p=areas / areas.sum()))
            place, axes = _on_face(face, size, rng.uniform(0.06, 0.94, 2))
            apart = min(
                float(np.linalg.norm(place - t.place)) / (t.radius + radius) for t in targets
            )
            if apart > 5.0:
                break
        targets.append(Target(number=number, place=place, axes=axes, radius=radius))
    return targets, bars


def _on_face(face: int, size: Array, at: Array) -> tuple[Array, Array]:
    axis, end = ((2, 1), (1, 0), (1, 1), (0, 0), (0, 1))[face]
    normal = np.zeros(3)
    normal[axis] = 1.0 if end else -1.0
    place = end * size * np.abs(normal)
    place[[i for i in range(3) if i != axis]] = at * size[[i for i in range(3) if i != axis]]
    x = np.eye(3)[(axis + 1) % 3]
    return place, np.column_stack([x, np.cross(normal, x), normal])


def poses_of(plan: Plan, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """Return turn (camera_R_block) and place of each photograph, all around."""
    middle = 0.5 * np.array([plan.length, plan.width, 0.7 * plan.height])
    poses = []
    for i in range(plan.photos):
        around = 2 * np.pi * i / plan.photos + rng.uniform(-0.1, 0.1)
        up = np.radians((18.0, 38.0, 60.0, 30.0)[i % 4] + rng.uniform(-4, 4))
        away = plan.distance * plan.length * rng.uniform(0.85, 1.1)
        look = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        place = middle + away * look
        z = middle + rng.normal(0, 0.04, 3) * plan.length - place
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        roll = Rotation.from_rotvec([0, 0, np.pi / 2 * (i // 2 % 4) + rng.uniform(-0.2, 0.2)])
        poses.append((roll.as_matrix() @ np.array([x, np.cross(z, x), z]), place))
    return poses


def lens_of(plan: Plan) -> Array:
    """Return the lens: see `omm_core.survey.camera_model`."""
    return np.array([1.017 * plan.focal_px, -5.5, 2.4, -0.095, 0.09, 0.0, 1.2e-4, -8e-5, 0.0, 0.0])


def seen_in(plan: Plan, target: Target, turn: Array, place: Array) -> Array | None:
    """Return where a target's centre appears, px; None where it does not."""
    towards = place - target.place
    distance = float(np.linalg.norm(towards))
    if target.axes[:, 2] @ towards < _STEEPEST * distance or _hidden(plan, target.place, place):
        return None
    middle = np.array([plan.width_px - 1, plan.height_px - 1]) / 2.0
    at = lens_pixels(lens_of(plan), (turn @ -towards)[None])[0] + middle
    room = 4.5 * target.radius * plan.focal_px / distance + 3.0
    inside = (at > room).all() and (at < 2 * middle - room).all()
    return at if inside else None


def _hidden(plan: Plan, start: Array, end: Array) -> bool:
    size = np.array([plan.length, plan.width, plan.height])
    for s in np.linspace(1e-3, 0.6, 200):
        p = start + s * (end - start)
        if (p > 1e-6 * size).all() and (p < size * (1 - 1e-6)).all():
            return True
    return False


def draw(plan: Plan, targets: list[Target], pose: tuple[Array, Array], seed: int) -> Array:
    """Return one photograph, grey values (H, W)."""
    rng = np.random.default_rng([plan.seed, seed])
    coarse = rng.normal(0.0, 3.0, (plan.height_px // 250 + 2, plan.width_px // 250 + 2))
    grown = cv2.resize(coarse, (plan.width_px, plan.height_px), interpolation=cv2.INTER_CUBIC)
    image = np.maximum(_DARK + grown, 1.0)
    turn, place = pose
    family = TargetFamily.by_name(plan.family)
    lens, middle = lens_of(plan), np.array([plan.width_px - 1, plan.height_px - 1]) / 2.0
    for target in targets:
        at = seen_in(plan, target, turn, place)
        if at is None:
            continue

        def plane(col: Array, row: Array, target: Target = target) -> tuple[Array, Array]:
            pixels = np.column_stack([col.ravel(), row.ravel()]) - middle
            looks = np.column_stack([undistorted(lens, pixels), np.ones(col.size)]) @ turn
            off = target.place - place
            far = (target.axes[:, 2] @ off) / (looks @ target.axes[:, 2])
            local = (looks * far[:, None] - off) @ target.axes
            return local[:, 0].reshape(col.shape), local[:, 1].reshape(col.shape)

        towards = place - target.place
        distance = float(np.linalg.norm(towards))
        outer = 4.2 if target.number else 1.7
        half = int(np.ceil(outer * target.radius * lens[0] / distance)) + 6
        col0, row0 = np.round(at).astype(int) - half
        window = (int(col0), int(row0), 2 * half + 1, 2 * half + 1)
        code = family.code_of(target.number) if target.number else 0
        drawn = target_coverage(
            code=code, family=family, dot_radius_mm=target.radius, plane_of_pixel=plane,
            window=window, blur_px=_BLUR_PX, ring=target.number > 0,
        )  # fmt: skip
        label = target_coverage(
            code=0, family=family, dot_radius_mm=outer * target.radius, plane_of_pixel=plane,
            window=window, blur_px=_BLUR_PX, ring=False,
        )  # fmt: skip
        light = _BRIGHT * float(target.axes[:, 2] @ towards / distance) ** 0.3
        there = image[row0 : row0 + 2 * half + 1, col0 : col0 + 2 * half + 1]
        height, width = there.shape
        drawn, label = drawn[:height, :width], label[:height, :width]
        there += (_LABEL - there) * label + (light - _LABEL) * drawn
    image += rng.normal(0.0, 1.0, image.shape) * np.sqrt(_NOISE_DN**2 + 0.02 * image)
    return image


def _write(job: tuple[Plan, list[Target], tuple[Array, Array], int, Path]) -> None:
    plan, targets, pose, number, path = job
    cv2.setNumThreads(1)
    pixels = np.clip(np.round(draw(plan, targets, pose, number)), 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), pixels, [cv2.IMWRITE_JPEG_QUALITY, 96])


def draw_set(folder: Path, plan: Plan) -> None:
    """Write the photographs, survey.yaml and truth.json."""
    rng = np.random.default_rng(plan.seed)
    targets, bars = targets_of(plan, rng)
    poses = poses_of(plan, rng)
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"photo_{i + 1:03d}{plan.suffix}" for i in range(plan.photos)]
    jobs = [
        (plan, targets, pose, i, folder / name)
        for i, (pose, name) in enumerate(zip(poses, names, strict=True))
    ]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(_write, jobs))
    given = {
        "camera": {
            "width_px": plan.width_px, "height_px": plan.height_px, "pixel_size_mm": 0.0055,
            "focal_length_mm": 0.0055 * plan.focal_px,
        },
        "photos": f"photo_*{plan.suffix}", "target_family": plan.family,
        "coded_dot_diameter_mm": plan.coded_dot, "plain_dot_diameter_mm": plan.plain_dot,
        "scale_bars": bars[:2], "check_bars": bars[2:],
    }  # fmt: skip
    (folder / "survey.yaml").write_text(yaml.safe_dump(given, sort_keys=False))
    rays = [sum(seen_in(plan, t, *pose) is not None for pose in poses) for t in targets]
    truth = {
        "points": [
            {"id": t.number or None, "xyz_mm": t.place.tolist(), "rays": n}
            for t, n in zip(targets, rays, strict=True)
        ]
    }
    (folder / "truth.json").write_text(json.dumps(truth))


def check(folder: Path, result: dict[str, Any]) -> str:
    """Return how far a result lies from the truth."""
    truth = json.loads((folder / "truth.json").read_text())["points"]
    true = {p["id"]: np.array(p["xyz_mm"]) for p in truth if p["id"] is not None}
    plain = np.array([p["xyz_mm"] for p in truth if p["id"] is None]).reshape(-1, 3)
    coded = [p for p in result["points"] if p["coded"]]
    there = np.array([p["xyz_mm"] for p in coded])
    wanted = np.array([true[p["id"]] for p in coded])
    turn, _ = Rotation.align_vectors(wanted - wanted.mean(0), there - there.mean(0))
    words, wrong = [], 0
    for kind in (True, False):
        errors, squares, claimed = [], [], set()
        for p in result["points"]:
            if p["coded"] != kind:
                continue
            at = turn.apply(np.array(p["xyz_mm"]) - there.mean(0)) + wanted.mean(0)
            near = int(np.argmin(np.linalg.norm(plain - at, axis=1))) if len(plain) else -1
            error = at - (true[p["id"]] if kind else plain[near])
            if not kind and (np.linalg.norm(error) > 1.0 or near in claimed):
                wrong += 1
                continue
            claimed.add(p["id"] if kind else near)
            errors.append(error)
            covariance = turn.as_matrix() @ np.array(p["covariance_mm2"]) @ turn.as_matrix().T
            squares.append(error @ np.linalg.solve(covariance, error) / 3.0)
        if errors:
            rms, most = np.sqrt(np.mean(np.square(errors), axis=0)), np.abs(errors).max()
            there_are = sum((p["id"] is not None) == kind and p["rays"] >= 3 for p in truth)
            words.append(
                f"{'coded' if kind else 'plain'}: {len(errors)} of {there_are} with 3 rays; rms"
                f" {' '.join(f'{x:.4f}' for x in rms)} mm, largest {most:.4f};"
                f" squared error over covariance {np.mean(squares):.2f}"
            )
    return "\n".join([*words, f"plain targets that are not there: {wrong}"])


def main() -> None:
    """Draw, or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--check", type=Path, metavar="RESULT.json")
    for field in fields(Plan):
        parser.add_argument(f"--{field.name}", type=type(field.default), default=field.default)
    arguments = vars(parser.parse_args())
    folder, result = arguments.pop("folder"), arguments.pop("check")
    if result is not None:
        print(check(folder, json.loads(result.read_text())))
    else:
        draw_set(folder, Plan(**arguments))


if __name__ == "__main__":
    main()
