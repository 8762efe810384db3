"""Ring-coded targets: families, detection, centring, printing."""

from omm_core.targets.coded.detection import DetectionOptions, detect_targets
from omm_core.targets.coded.families import TargetFamily, family_names
from omm_core.targets.detected import DetectedTarget, Detection, RefusedTarget

__all__ = [
    "DetectedTarget",
    "Detection",
    "DetectionOptions",
    "RefusedTarget",
    "TargetFamily",
    "detect_targets",
    "family_names",
]
