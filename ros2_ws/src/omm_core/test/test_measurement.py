"""The measuring session: live and replayed alike, every image accounted for."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from core_cells import PAPER_CALIBRATION, bench_cell

from omm_core.errors import InputError
from omm_core.session.measurement import Measurement
from omm_core.targets.coded.families import TargetFamily, mirror_code

MS = 1_000_000


@dataclass(frozen=True)
class Found:
    """A detected target, as far as a measurement needs it."""

    id: int
    center_px: np.ndarray
    covariance_px2: np.ndarray


def found_of(observation, **changes):
    return Found(
        id=changes.get("id", observation.target_id),
        center_px=changes.get("center_px", observation.center_px),
        covariance_px2=observation.covariance_px2,
    )


def events(observations):
    """Return what comes in, as (method, stamp_ns, content): poses at 100 Hz, and detections."""
    poses, images = [], {}
    for observation in observations:
        around = range(observation.stamp_ns - 150 * MS, observation.stamp_ns + 151 * MS, 10 * MS)
        poses += [("add_pose", stamp, observation.machine_T_spindle) for stamp in around]
        images.setdefault(observation.stamp_ns, []).append(found_of(observation))
    return poses + [("add_detection", stamp, found) for stamp, found in images.items()]


def measured(cell, given):
    measurement = Measurement(cell.part, cell.calibration)
    for method, stamp, content in given:
        getattr(measurement, method)(stamp, content)
    return measurement


@pytest.fixture
def cell():
    return bench_cell(np.random.default_rng(5))


@pytest.fixture
def observations(cell):
    return cell.noisy(np.random.default_rng(6), 0.05)


def test_a_measurement_solves_from_its_images(cell, observations):
    result = measured(cell, events(observations)).result()
    assert result.determined
    sigma = np.sqrt(np.diag(result.solution.covariance))
    assert np.all(np.abs(result.solution.theta - cell.theta) < 4 * sigma)
    assert all(image.used for image in result.images)
    assert result.images_per_target == {42: 2, 40: 2, 8: 2, 122: 2}


def test_the_result_is_the_same_to_the_bit_in_any_order_and_with_results_in_between(
    cell, observations
):
    given = events(observations)
    expected = json.dumps(measured(cell, given).result().to_json_dict())
    random = np.random.default_rng(1)
    for _ in range(3):
        shuffled = [given[i] for i in random.permutation(len(given))] + given[:40]
        measurement = Measurement(cell.part, cell.calibration)
        for number, (method, stamp, content) in enumerate(shuffled):
            getattr(measurement, method)(stamp, content)
            if number % 97 == 0:
                measurement.result()
        assert json.dumps(measurement.result().to_json_dict()) == expected


def test_the_json_is_that_of_the_contract(cell, observations):
    written = json.dumps(measured(cell, events(observations)).result().to_json_dict())
    content = json.loads(written)
    names = ["alpha_rad", "beta_rad", "gamma_rad", "x_mm", "y_mm", "z_mm", "gamma_s_rad"]
    assert (content["model"], content["converged"]) == ("7d", True)
    assert list(content["theta"]) == names
    assert np.shape(content["covariance"]) == (7, 7)
    assert content["degrees_of_freedom"] == 9
    assert content["rms_px"] > 0
    assert content["sigma0"] > 0
    image, observation = content["images"][0], content["observations"][0]
    assert image == {"stamp_ns": 1_000_000_000, "used": True, "reason": None}
    assert {"stamp_ns", "target_id", "col_px", "row_px", "residual_px", "used", "reason"} <= set(
        observation
    )
    assert len(observation["residual_px"]) == 2


def test_residuals_are_computed_minus_measured(cell):
    observations = list(cell.observations)
    observations[0] = replace(
        observations[0], center_px=observations[0].center_px + np.array([0.05, 0.0])
    )
    result = measured(cell, events(observations)).result()
    assert result.observations[0].residual_px[0] < 0


def test_before_it_is_determined_nothing_is_published(cell, observations):
    result = measured(cell, events(observations[:2])).result()
    assert not result.determined
    assert np.isnan(result.solution.theta).all()
    assert "only target 42 was seen" in result.missing[0]
    assert json.loads(json.dumps(result.to_json_dict()))["theta"]["x_mm"] is None
    assert all(image.used for image in result.images)


def test_nothing_at_all_is_a_result_too(cell):
    result = Measurement(cell.part, cell.calibration).result()
    assert not result.determined
    assert result.images == ()


def test_an_image_waits_for_the_poses_after_it(cell, observations):
    given = events(observations)
    last = max(stamp for method, stamp, _ in given if method == "add_detection")
    early = [e for e in given if e[0] == "add_detection" or e[1] < last + 5 * MS]
    measurement = measured(cell, early)
    result = measurement.result()
    assert measurement.images_pending == result.images_pending == 1
    assert result.images[-1].pending
    for method, stamp, content in given:
        getattr(measurement, method)(stamp, content)
    assert measurement.images_pending == 0
    assert all(image.used for image in measurement.result().images)


def test_every_image_that_is_not_used_has_its_reason(cell, observations):
    given = events(observations)
    images = [e for e in given if e[0] == "add_detection"]
    elsewhere = found_of(observations[0], center_px=observations[0].center_px + 1.0)
    extra = [
        ("add_detection", 50_000 * MS, [elsewhere]),  # no poses there
        ("add_detection", images[0][1] + 1 * MS, []),
        ("add_detection", images[0][1] + 2 * MS, [found_of(observations[0], id=77)]),
        ("add_detection", images[0][1] + 3 * MS, images[0][2]),  # sent again, stale
        ("add_detection", images[7][1], [found_of(observations[1])]),  # other image, same stamp
        ("add_refused_image", 70_000 * MS, "encoding bayer is not mono"),
    ]
    result = measured(cell, given + extra).result()
    reasons = {image.stamp_ns: image.reason for image in result.images if not image.used}
    assert reasons == {
        50_000 * MS: "no spindle pose after the image",
        images[0][1] + 1 * MS: "no target was found",
        images[0][1] + 2 * MS: "no target of the part was found",
        images[0][1] + 3 * MS: f"the camera sent image 1 of 13 ({images[0][1]} ns) again",
        images[7][1]: "2 different images carry this stamp",
        70_000 * MS: "encoding bayer is not mono",
    }
    assert result.determined


def test_words_count_all_images_of_the_run_those_that_come_later_and_show_nothing_too(
    cell, observations
):
    wrong = [replace(observations[0], center_px=observations[0].center_px + 2.0), *observations[1:]]
    measurement = measured(cell, events(wrong))
    first = measurement.result().images[0].stamp_ns
    (words,) = measurement.result().findings
    assert f"in image 1 of 8 ({first} ns) is" in words
    measurement.add_detection(first - 1 * MS, [])
    (words,) = measurement.result().findings
    assert f"in image 2 of 9 ({first} ns) is" in words


def test_targets_that_are_not_in_the_part_appear_unused(cell, observations):
    given = events(observations)
    method, stamp, found = next(e for e in given if e[0] == "add_detection")
    given.remove((method, stamp, found))
    given.append((method, stamp, [*found, found_of(observations[0], id=77)]))
    result = measured(cell, given).result()
    (stranger,) = (o for o in result.observations if o.target_id == 77)
    assert not stranger.used
    assert stranger.reason == "not a target of the part"
    assert json.loads(json.dumps(result.to_json_dict()))["observations"][1]["residual_px"] == [
        None,
        None,
    ]


def test_a_number_found_twice_in_an_image_is_not_used(cell, observations):
    given = events(observations)
    method, stamp, found = next(e for e in given if e[0] == "add_detection")
    given.remove((method, stamp, found))
    other = found_of(observations[0], center_px=observations[0].center_px + 200.0)
    given.append((method, stamp, [*found, other]))
    result = measured(cell, given).result()
    twice = [o for o in result.observations if o.stamp_ns == stamp]
    assert [o.used for o in twice] == [False, False]
    assert all("more than once" in o.reason for o in twice)
    assert result.determined


def test_one_bad_image_of_eight_is_named_and_the_rest_solved(cell, observations):
    bad = list(observations)
    bad[3] = replace(bad[3], center_px=bad[3].center_px + 3.0)
    result = measured(cell, events(bad)).result()
    assert result.determined
    assert [image.used for image in result.images].count(False) == 1
    assert "target 40" in result.findings[0]
    assert result.images[3].reason == result.findings[0]


def test_mirrored_numbers_are_told(cell, observations):
    family = TargetFamily.by_name(cell.part.target_family)

    def mirrored(target_id):
        return family.id_of(mirror_code(family.code_of(target_id), family.bits))

    turned = {t.id: mirrored(t.id) for t in cell.part.targets}
    assert sum(a != b for a, b in turned.items()) >= 2  # else a mirror could not be noticed
    given = [
        (method, stamp, content)
        if method == "add_pose"
        else (method, stamp, [replace(f, id=turned[f.id]) for f in content])
        for method, stamp, content in events(observations)
    ]
    result = measured(cell, given).result()
    assert not result.determined
    assert "mirrored" in result.missing[0]


def test_an_image_of_another_sensor_is_refused(cell):
    measurement = Measurement(cell.part, PAPER_CALIBRATION)
    with pytest.raises(InputError, match="2592 x 1944"):
        measurement.add_image(0, np.zeros((480, 640), dtype=np.uint8))
