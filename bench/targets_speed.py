"""Time to find 12 targets in 2592 × 1944, against AprilTag 3 and cv2.aruco on the same frames.

    ./omm exec python bench/targets_speed.py

CPU time on one thread, median of several runs in turn; the ratios count. AprilTag and aruco find
none of their own tags in these frames: their time is that of looking.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable

import cv2
import numpy as np

from omm_core.targets import TargetFamily, detect_targets
from omm_simulation.target_image import affine_plane, disc_coverage, target_coverage

WIDTH, HEIGHT = 2592, 1944


def clutter(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Machined metal with milling marks, bright ellipses, arcs, holes and letters (DN)."""
    height, width = shape
    scale = height * width / (WIDTH * HEIGHT)
    rows, cols = np.mgrid[:height, :width]
    marks = 8.0 * np.sin(np.hypot(rows + 900.0, cols + 300.0) / 5.0)
    grain = 6.0 * cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 1.5)
    things = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(150 * scale)):
        centre = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        axes = (int(rng.uniform(4, 60)), int(rng.uniform(4, 60)))
        begin = 0.0 if rng.random() < 0.6 else float(rng.uniform(0, 200))
        cv2.ellipse(
            things,
            centre,
            axes,
            float(rng.uniform(0, 180)),
            begin,
            360.0,
            int(rng.uniform(60, 250)),
            int(rng.choice([-1, 2, 6])),
            cv2.LINE_AA,
        )
    for _ in range(int(40 * scale)):
        text = "".join(rng.choice(list("ABO0Q8D9"), 3))
        place = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        cv2.putText(
            things,
            text,
            place,
            cv2.FONT_HERSHEY_SIMPLEX,
            float(rng.uniform(0.5, 3)),
            int(rng.uniform(80, 250)),
            3,
            cv2.LINE_AA,
        )
    return np.maximum(25.0 + marks + grain, cv2.GaussianBlur(things, (0, 0), 0.8).astype(float))


def frame(
    cluttered: bool,
    targets: int = 12,
    shape: tuple[int, int] = (HEIGHT, WIDTH),
    seed: int = 1,
    name: str = "metashape12",
) -> np.ndarray:
    """Return a frame with dots of 40 px in a grid, each on its black label."""
    rng = np.random.default_rng(seed)
    family = TargetFamily.by_name(name)
    image = clutter(shape, rng) if cluttered else np.full(shape, 20.0)
    columns = int(np.ceil(np.sqrt(targets * shape[1] / shape[0])))
    pitch = shape[1] / columns
    for index in range(targets):
        row, column = divmod(index, columns)
        centre = (np.array([column, row]) + 0.5) * pitch + rng.uniform(-10, 10, 2)
        half = 84
        window = (int(centre[0]) - half, int(centre[1]) - half, 2 * half, 2 * half)
        plane = affine_plane(centre_px=tuple(centre), radius_px=20.0, tilt_rad=0.5, axis_rad=index)
        label = disc_coverage(
            centre_mm=(0, 0), radius_mm=4.0, plane_of_pixel=plane, window=window, blur_px=0.8
        )
        cover = target_coverage(
            code=family.code_of(index % len(family) + 1),
            family=family,
            dot_radius_mm=1.0,
            plane_of_pixel=plane,
            window=window,
            blur_px=0.8,
        )
        view = image[window[1] : window[1] + 2 * half, window[0] : window[0] + 2 * half]
        view[:] = view * (1 - label) + 15.0 * label + 165.0 * cover
    image = image + rng.normal(size=shape) * np.sqrt(4.0 + 0.1 * np.maximum(image, 0))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def cpu_ms(work: Callable[[], object], runs: int) -> float:
    """Median CPU time of one call."""
    work()
    times = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return 1e3 * float(np.median(times))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument(
        "--frames", type=int, default=0, help="watch the memory over so many frames"
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    family = TargetFamily.by_name("metashape12")
    aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    try:
        from apriltag import apriltag

        april = apriltag("tag36h11", threads=1, decimate=2.0)
    except ImportError:
        april = None
    print("| background | found | omm ms | AprilTag 3 ms | omm / AprilTag | cv2.aruco ms |")
    print("|---|---|---|---|---|---|")
    for name, cluttered in (("plain", False), ("cluttered", True)):
        image = frame(cluttered)
        found = len(detect_targets(image, family).targets)
        ours = cpu_ms(lambda image=image: detect_targets(image, family), args.runs)
        theirs = cpu_ms(lambda image=image: april.detect(image), args.runs) if april else np.nan
        others = cpu_ms(lambda image=image: aruco.detectMarkers(image), max(args.runs // 3, 1))
        print(
            f"| {name} | {found} of 12 | {ours:.1f} | {theirs:.1f} | {ours / theirs:.3f} "
            f"| {others:.1f} |",
            flush=True,
        )
    # 161 numbers of 12 bit are not enough: a number that is seen twice is refused.
    many = TargetFamily.by_name("metashape14")
    large = frame(True, targets=200, shape=(3888, 5184), name=many.name)
    found = len(detect_targets(large, many).targets)
    print(
        f"\n20 MP, cluttered, 200 targets: {found} found in "
        f"{cpu_ms(lambda: detect_targets(large, many), 3):.0f} ms"
    )
    if args.frames:
        image = frame(False)[:600, :800].copy()
        detect_targets(image, family)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for _ in range(args.frames):
            detect_targets(image, family)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(f"{args.frames} frames: memory grew by {grown} kB")


if __name__ == "__main__":
    main()
