"""After the warm-up no kernel is compiled: no image waits ten seconds for a compiler."""

import sys

import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.targets import TargetFamily, detect_targets
from omm_core.warm_up import warm_up_detection


def compiled() -> int:
    """Number of types that the kernels have been compiled for."""
    modules = [module for name, module in sys.modules.items() if name.startswith("omm_core")]
    kernels = {id(k): k for m in modules for k in vars(m).values() if hasattr(k, "signatures")}
    return sum(len(kernel.signatures) for kernel in kernels.values())


def read_only(image):
    image.flags.writeable = False
    return image


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    "form", [np.array, read_only, np.asfortranarray, lambda image: image[3:, 2:]]
)
def test_no_image_needs_kernels_of_its_own(dtype, form):
    rng = np.random.default_rng(1)
    image, _ = target_image(rng, name="aicon14")
    warm_up_detection()
    before = compiled()
    found = detect_targets(form(as_seen(rng, image, dtype=dtype)), TargetFamily.by_name("aicon14"))
    assert [target.id for target in found.targets] == [42]
    assert compiled() == before
