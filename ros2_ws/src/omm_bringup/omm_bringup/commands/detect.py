"""`./omm detect`: coded targets in photographs."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omm_core.errors import InputError
from omm_core.files.output import write_whole

if TYPE_CHECKING:
    from omm_core.targets import Detection


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("images", nargs="+", metavar="IMAGE", help="files, folders or patterns")
    parser.add_argument("--family", required=True, help="aicon12, aicon14, metashape12, …")
    parser.add_argument("--json", metavar="OUT", help="write the result; - for the screen")
    parser.add_argument(
        "--overlay",
        metavar="FOLDER",
        nargs="?",
        const="",
        help="draw the result: beside each image, or into a folder",
    )
    parser.add_argument("--polarity", choices=("both", "bright", "dark"), default="both")
    parser.add_argument("--min-contrast-dn", type=float, default=20.0)
    parser.add_argument(
        "--centring",
        choices=("fit", "outline"),
        default="fit",
        help="outline is faster and less accurate",
    )
    parser.add_argument(
        "--expect",
        metavar="IDS",
        help="the part's numbers, such as 1-10,15: notices mirrored images",
    )


def run(args: argparse.Namespace) -> int:
    """Detect targets in all images; exit 1 if an image could not be read."""
    from rich.console import Console
    from rich.progress import track

    from omm_core.imaging.photographs import find_images, read_grey
    from omm_core.targets import DetectionOptions, TargetFamily, detect_targets
    from omm_core.targets.coded.printing import parse_ids

    family = TargetFamily.by_name(args.family)
    expected = frozenset(parse_ids(args.expect)) if args.expect else None
    options = DetectionOptions(
        polarity=args.polarity,
        min_contrast_dn=args.min_contrast_dn,
        centring=args.centring,
        expected_ids=expected,
    )
    paths = find_images(args.images)
    console = Console(stderr=True)
    results, failed = [], 0
    shown = track(paths, "Detecting", console=console, transient=True, disable=len(paths) < 3)
    for path in shown:
        try:
            image = read_grey(path)
        except InputError as error:
            console.print(
                f"omm: {error}", style="red", markup=False, highlight=False, soft_wrap=True
            )
            failed += 1
            continue
        detection = detect_targets(image, family, options)
        results.append(as_json(path, detection))
        if args.overlay is not None:
            _write_overlay(path, args.overlay, image, detection)
        if args.json != "-":
            _show(path, detection)
    if args.json:
        _write_json(args.json, results)
    return 1 if failed else 0


def as_json(path: Path, detection: Detection) -> dict[str, Any]:
    """Return one image's entry, with the keys of the contract first."""
    return {
        "image": str(path),
        "targets": [
            {
                "id": target.id,
                "col_px": float(target.center_px[0]),
                "row_px": float(target.center_px[1]),
                "covariance_px2": target.covariance_px2.tolist(),
                "diameter_px": float(target.diameter_px),
                "bright": target.bright,
                "contrast_dn": target.contrast_dn,
                "ring_margin": target.ring_margin,
            }
            for target in detection.targets
        ],
        "refused": [
            {
                "col_px": float(refused.center_px[0]),
                "row_px": float(refused.center_px[1]),
                "diameter_px": float(refused.diameter_px),
                "reason": refused.reason,
            }
            for refused in detection.refused
        ],
    }


def _show(path: Path, detection: Detection) -> None:
    print(f"{path}: {len(detection.targets)} targets")
    for target in detection.targets:
        sigma = (target.covariance_px2[0, 0] + target.covariance_px2[1, 1]) ** 0.5
        print(
            f"  {target.id:>6}  {target.center_px[0]:10.3f} {target.center_px[1]:10.3f} px"
            f"  ±{sigma:.3f}  dot {target.diameter_px:.1f} px"
        )
    for refused in detection.refused:
        print(
            f"  refused {refused.center_px[0]:9.1f} {refused.center_px[1]:10.1f} px"
            f"  {refused.reason}"
        )


def _write_json(out: str, results: list[dict[str, Any]]) -> None:
    text = json.dumps(results, indent=1) + "\n"
    if out == "-":
        sys.stdout.write(text)
        return
    from omm_core.files.output import write_whole

    write_whole(Path(out), text)


def _write_overlay(path: Path, folder: str, image: Any, detection: Detection) -> None:
    import cv2

    from omm_core.imaging.photographs import SUFFIXES
    from omm_core.targets.overlay import draw_detection

    target = Path(folder) if folder else path.parent
    if target.suffix.lower() in SUFFIXES:
        raise InputError(f"--overlay {folder}: expected a folder, got the name of an image.")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--overlay {folder}: {error.strerror or error}") from error
    out = target / f"{path.stem}_targets.png"
    # OpenCV ends the process at names that are not UTF-8: it encodes only, Python writes.
    encoded, data = cv2.imencode(".png", draw_detection(image, detection))
    if not encoded:
        raise InputError(f"{out}: the picture cannot be encoded.")
    write_whole(out, data.tobytes())
    print(f"  drawn: {out}")
