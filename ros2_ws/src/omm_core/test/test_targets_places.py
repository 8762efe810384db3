"""What is a target to a person is found, or refused with a reason, wherever the pixels fall."""

import numpy as np
import pytest
from target_scenes import as_seen, target_image

from omm_core.targets import detect_targets
from omm_core.targets.coded.families import TargetFamily

FAMILY = TargetFamily.by_name("aicon14")


@pytest.mark.parametrize("blur_px", [0.4, 0.6, 0.9])
@pytest.mark.parametrize("tilt_deg", [10.0, 30.0, 45.0])
def test_sharp_small_targets_are_found_or_refused_at_any_place(blur_px, tilt_deg):
    rng = np.random.default_rng(round(100 * blur_px + tilt_deg))
    found = 0
    for _ in range(40):
        target_id = int(rng.integers(1, len(FAMILY) + 1))
        image, centre = target_image(
            rng,
            target_id=target_id,
            name=FAMILY.name,
            diameter_px=float(rng.uniform(13.0, 15.0)),
            tilt_deg=tilt_deg,
            blur_px=blur_px,
            contrast_dn=73.0,
        )
        seen = detect_targets(as_seen(rng, image, read_dn=1.0), FAMILY)
        assert [target.id for target in seen.targets] in ([], [target_id])
        places = [target.center_px for target in (*seen.targets, *seen.refused)]
        assert any(np.hypot(*(place - centre)) < 3.0 for place in places)
        found += len(seen.targets)
    assert found >= 39
