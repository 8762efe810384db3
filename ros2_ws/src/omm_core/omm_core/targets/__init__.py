"""Ring-coded targets: families, detection, centring, printing."""

from omm_core.targets.detected import DetectedTarget, Detection, RefusedTarget
from omm_core.targets.detection import DetectionOptions, detect_targets
from omm_core.targets.families import TargetFamily, family_names

__all__ = [
    "DetectedTarget",
    "Detection",
    "DetectionOptions",
    "RefusedTarget",
    "TargetFamily",
    "detect_targets",
    "family_names",
]
