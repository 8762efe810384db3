"""Write part.yaml: coded targets in the ideal part frame, with their full covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Target

Array = NDArray[np.float64]


def part_yaml(
    *,
    name: str,
    target_family: str,
    targets: Sequence[Target],
    covariance_mm2: Array | None,
    box_mm: Array | None = None,
) -> str:
    """Return part.yaml; the covariance (3T, 3T) is in the order of the targets."""
    import yaml

    content: dict[str, object] = {
        "part": {"name": name},
        "target_family": target_family,
        "targets": [_entry(target) for target in targets],
    }
    if box_mm is not None:
        content["box_mm"] = [[round(float(v), 6) for v in corner] for corner in box_mm]
    if covariance_mm2 is not None:
        content["covariance_mm2"] = [[float(v) for v in row] for row in covariance_mm2]
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)


def _entry(target: Target) -> dict[str, object]:
    entry: dict[str, object] = {
        "id": target.id,
        "xyz_mm": [round(float(v), 6) for v in target.xyz_mm],
        "dot_diameter_mm": target.dot_diameter_mm,
    }
    if target.normal is not None:
        entry["normal"] = [round(float(v), 9) for v in target.normal]
    if target.sigma_xyz_mm is not None:
        entry["sigma_xyz_mm"] = [round(float(v), 6) for v in target.sigma_xyz_mm]
    return entry
