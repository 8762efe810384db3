"""Ring-coded targets: families, detection, centring, printing."""

from omm_core.targets.families import TargetFamily, family_names

__all__ = ["TargetFamily", "family_names"]
