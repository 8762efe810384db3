"""After the warm-up no kernel is compiled: no image waits ten seconds for a compiler."""

import sys

import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.adjustment import Block, Group, Problem, solve
from omm_core.adjustment import test_observations as observation_tests
from omm_core.targets import TargetFamily, detect_targets
from omm_core.warm_up import warm_up_adjustment, warm_up_detection


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


@pytest.mark.parametrize("form", [np.array, read_only, np.asfortranarray, lambda array: array[::1]])
def test_no_network_needs_kernels_of_its_own(form):
    rng = np.random.default_rng(1)
    design = form(rng.normal(size=(5, 2, 2)))
    block = Block(
        name="block",
        observed=form(rng.normal(size=(5, 2))),
        covariance=np.broadcast_to(np.eye(2), (5, 2, 2)),
        index={"group": np.zeros(5, dtype=np.int32)},
        evaluate=lambda values: (form(design @ values["group"][0]), {"group": design}),
        used=np.array([True, True, True, True, False]),
    )
    problem = Problem(groups=(Group(name="group", values=np.zeros((1, 2))),), blocks=(block,))
    warm_up_adjustment()
    before = compiled()
    wanted = np.linalg.lstsq(design[:4].reshape(8, 2), block.observed[:4].ravel(), rcond=None)[0]
    solution = solve(problem)
    observation_tests(problem, solution)
    assert np.allclose(solution.values["group"][0], wanted, atol=1e-9)
    assert compiled() == before
