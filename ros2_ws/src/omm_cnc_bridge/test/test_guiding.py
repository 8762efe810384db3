"""What the bridge tells a program of where the part is, and that it waits for the estimator."""

import json

import numpy as np
import pytest

from omm_cnc_bridge.control import ControlSample
from omm_cnc_bridge.guiding import Guiding, GuidingFiles
from omm_cnc_bridge.handshake import Acknowledge, Handshake, HandshakeLimits, Trigger
from omm_core.errors import InputError
from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import Joint, Robot
from omm_core.planning.plan_file import guide_from_plan
from omm_simulation.scenario import load_scenario

S = 1_000_000_000
LINKS = ("machine", "a", "b", "spindle")
MILL = Kinematics(
    Robot(
        name="mill", root="machine", links=LINKS,
        joints=tuple(
            Joint(
                name=name, movable=True, rotary=False, parent=LINKS[i], child=LINKS[i + 1],
                origin=np.eye(4), axis=np.eye(3)[i], lower=-2000.0, upper=3000.0,
            )
            for i, name in enumerate("XYZ")
        ),
    )
)  # fmt: skip
STOPS = [
    {"axes": {"X": 10.0, "Y": 20.0, "Z": 620.0}, "targets": [42]},
    {"axes": {"X": -30.0, "Y": 10.0, "Z": 620.0}, "targets": [42]},
]
PLAN = {
    "part_taken_at": {"translation_mm": [0.0, 0.0, 0.0], "euler_xyz_rad": [0.0, 0.0, 0.0]},
    "program": {"images": 2, "limit_mm": 50.0, "stops": STOPS},
}


@pytest.fixture
def files(tmp_path):
    bench = load_scenario("bench")
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    return GuidingFiles(
        plan_file=str(tmp_path / "plan.json"),
        part_file=str(bench.part_file),
        calibration_file=str(bench.calibration_file),
    )


@pytest.fixture
def guiding(files):
    return Guiding.load(files, MILL, timeout_ns=3 * S)


def image_of(target, shift_mm=0.0):
    """Centre and diameter of a target that lies ``shift_mm`` along x from where it should."""
    bench = load_scenario("bench")
    part, calibration = load_part(bench.part_file), load_calibration(bench.calibration_file)
    spindle = MILL.machine_T_spindle(STOPS[0]["axes"])
    at = part.target(target)
    place = (spindle @ calibration.taper_T_camera).inverse() @ (at.xyz_mm + [shift_mm, 0.0, 0.0])
    pixel = calibration.lens.project(place[None])[0]
    rim = calibration.lens.project((place + [at.dot_diameter_mm / 2, 0.0, 0.0])[None])[0]
    return {target: (pixel, 2.0 * float(np.linalg.norm(rim - pixel)))}


def test_the_next_stop_is_shifted_as_far_as_the_part(guiding):
    guiding.heard(running=True)
    guiding.observed(7 * S, image_of(42, shift_mm=12.0))
    told = guiding.correction(1, 7 * S, MILL.machine_T_spindle(STOPS[0]["axes"]))
    assert told.status == 1
    assert told.shift_mm == pytest.approx((12.0, 0.0, 0.0), abs=2.0)


def test_an_image_without_targets_is_looked_for_elsewhere(guiding):
    guiding.observed(7 * S, {})
    told = guiding.correction(1, 7 * S, MILL.machine_T_spindle(STOPS[0]["axes"]))
    assert told.status == 2
    assert any(told.shift_mm)


def test_a_silent_estimator_costs_the_correction_and_not_the_answer(guiding):
    assert not guiding.is_ready(7 * S, 9 * S)
    assert guiding.is_ready(7 * S, 11 * S)
    assert guiding.correction(1, 7 * S, MILL.machine_T_spindle(STOPS[0]["axes"])) is None


def test_a_new_program_does_not_believe_what_the_one_before_has_seen(guiding):
    spindle = MILL.machine_T_spindle(STOPS[0]["axes"])
    guiding.heard(running=True)
    guiding.observed(7 * S, image_of(42, shift_mm=30.0))
    guiding.correction(1, 7 * S, spindle)
    guiding.heard(running=False)
    guiding.heard(running=True)
    guiding.observed(8 * S, image_of(42))
    assert guiding.correction(1, 8 * S, spindle).status == 0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda plan: plan.pop("program"), "program"),
        (lambda plan: plan["program"]["stops"][0].update(targets=[7]), "target"),
        (lambda plan: plan["program"]["stops"][0]["axes"].pop("Y"), "Y"),
        (lambda plan: plan.update(part_taken_at=3), "something else"),
        (lambda plan: plan["program"].update(stops=[]), "stops"),
    ],
)
def test_a_file_that_is_no_plan_of_this_part_is_refused(spoil, message):
    bench = load_scenario("bench")
    plan = json.loads(json.dumps(PLAN))
    spoil(plan)
    with pytest.raises(InputError, match=message):
        guide_from_plan(
            plan, "plan.json", part=bench.part, calibration=bench.calibration, kinematics=MILL
        )


def test_a_plan_without_part_and_camera_is_refused(files):
    with pytest.raises(InputError, match="part_file"):
        Guiding.load(
            GuidingFiles(plan_file=files.plan_file, part_file="", calibration_file=""), MILL, S
        )


def test_the_handshake_answers_only_when_others_are_ready():
    ready = []
    handshake = Handshake(HandshakeLimits(hold_ns=0), lambda image_ns, now_ns: image_ns in ready)

    def sample(now_ns):
        told = ControlSample(
            stamp_ns=now_ns, stamp_uncertainty_ns=0, positions={}, measure_request=4
        )
        return handshake.sample(told, 0, now_ns)

    assert sample(S) == Trigger(attempt=1)
    handshake.image(1, S, "", S)
    assert sample(2 * S) is None
    ready.append(S)
    told = sample(3 * S)
    assert told == Acknowledge(request=4)
    assert told.image_ns == S
