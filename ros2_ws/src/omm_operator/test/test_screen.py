"""The screen's state: honest about what is not heard, and about what holds no longer."""

import json
from dataclasses import replace

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.part import Part
from omm_core.files.wishes import Jack, Nominal
from omm_core.geometry import RigidTransform
from omm_operator.screen.commands import COMMANDS, Command, parse
from omm_operator.screen.correcting import corrections_in_all_modes
from omm_operator.screen.facts import ControlFact, EstimateFact, HealthFact, ImageFact
from omm_operator.screen.handing import HandingOptions
from omm_operator.screen.result import advice, rows
from omm_operator.screen.screen import Screen
from omm_operator.screen.watch import LIMIT_S, STARTING_S, Watch
from omm_simulation.jacks import lifted_by_command

START_NS = 1_700_000_000_000_000_000
JACKS = tuple(
    Jack(name=f"J{k}", xyz_mm=np.array([x, y, 0.0]))
    for k, (x, y) in enumerate(((-4000, -1000), (4000, -1000), (4000, 1000), (-4000, 1000)), 1)
)


class Times:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.s = 100.0

    def ns(self) -> int:
        return START_NS + round(self.s * 1e9)


@pytest.fixture
def times() -> Times:
    return Times()


@pytest.fixture
def screen(times: Times) -> Screen:
    return Screen(options=HandingOptions(), wall_ns=times.ns, clock_s=lambda: times.s)


def part(**more: object) -> Part:
    nominal = Nominal(translation_mm=(None, None, 0.0), euler_xyz_rad=(0.0, 0.0, None))
    values = {
        "nominal": nominal,
        "tolerances": {"alpha_rad": 5e-5, "beta_rad": 5e-5, "z_mm": 1.0},
        "box_mm": np.array([[0.0, 0.0, 0.0], [1500.0, 1000.0, 500.0]]),
    }
    return Part(name="bed", target_family="aicon12", targets=(), jacks=JACKS, **(values | more))


def estimate(times: Times, theta: object = (0.0,) * 7, **more: object) -> EstimateFact:
    values = {
        "part": "bed",
        "determined": True,
        "converged": True,
        "theta": np.array(theta, dtype=float),
        "covariance": np.diag([1e-12] * 3 + [1e-6] * 3 + [1e-12]),
        "expanded_uncertainty": np.array([2e-6] * 3 + [2e-3] * 3 + [2e-6]),
        "stamp_ns": times.ns() - 1_000_000_000,
        "images": (ImageFact(stamp_ns=1, used=True),),
    }
    return EstimateFact(**(values | more))


def control(**more: object) -> ControlFact:
    values = {"control": "linuxcnc", "connection": 2, "program_state": 1, "in_position": True}
    return ControlFact(**(values | more))


def all_well(screen: Screen, times: Times) -> None:
    """Every station says that it is well, now."""
    for node, name in (
        ("estimator", "images"),
        ("camera", "connection"),
        ("recorder", "recording"),
    ):
        screen.take_health(HealthFact(node=node, name=name, level=0, message=""))
    screen.take_control(control())
    screen.tick()


def state_of(screen: Screen, name: str) -> str:
    return next(s["state"] for s in screen.snapshot()["sources"] if s["name"] == name)


@pytest.mark.parametrize("station", ["estimator", "camera", "bridge", "control", "recorder"])
def test_who_falls_silent_is_told_within_two_seconds(
    screen: Screen, times: Times, station: str
) -> None:
    all_well(screen, times)
    assert state_of(screen, station) == "ok"
    for _ in range(20):  # the others go on speaking
        times.s += 0.1
        all_well_but(screen, station)
        screen.tick()
    assert state_of(screen, station) == "silent"
    assert f"trouble.silent_{station}" in {t.said.key for t in screen.troubles.all()}
    all_well(screen, times)
    assert state_of(screen, station) == "ok"


def all_well_but(screen: Screen, station: str) -> None:
    for node, name in (
        ("estimator", "images"),
        ("camera", "connection"),
        ("recorder", "recording"),
    ):
        if node != station:
            screen.take_health(HealthFact(node=node, name=name, level=0, message=""))
    if station not in ("bridge", "control"):
        screen.take_control(control())


def test_a_control_that_the_bridge_no_longer_hears_is_a_fault(screen: Screen, times: Times) -> None:
    all_well(screen, times)
    screen.take_control(control(connection=0, detail="nothing answers"))
    screen.tick()
    assert state_of(screen, "bridge") == "ok"
    assert state_of(screen, "control") == "fault"
    assert screen.refusals()["start_program"] is not None


def test_a_station_that_starts_is_no_error_until_it_takes_too_long() -> None:
    watch = Watch()
    watch.hear("camera", 0.0, fine=False, detail="opening")
    assert watch.source("camera", 1.0).state == "waiting"
    watch.hear("camera", STARTING_S, fine=False, detail="opening")
    assert watch.source("camera", STARTING_S).state == "fault"
    watch.hear("camera", STARTING_S + 1, fine=True)
    watch.hear("camera", STARTING_S + 2, fine=False, detail="gone")
    assert watch.source("camera", STARTING_S + 2).state == "fault"


def test_a_node_that_left_is_silent_without_waiting() -> None:
    watch = Watch()
    watch.hear("estimator", 0.0)
    watch.lose("estimator")
    assert watch.source("estimator", LIMIT_S / 10).state == "silent"


def test_an_error_stays_until_it_is_acknowledged_and_is_counted(
    screen: Screen, times: Times
) -> None:
    bad = estimate(times, images=(ImageFact(stamp_ns=5, used=False, reason="no spindle pose"),))
    screen.take_estimate(bad)
    screen.take_estimate(bad)  # the same image again is no news
    for _ in range(3):
        screen.take_health(HealthFact(node="camera", name="images", level=0, message=""))
        screen.take_health(HealthFact(node="camera", name="images", level=2, message="lost"))
    told = screen.snapshot()["troubles"]["open"]
    assert [(t["said"]["key"], t["count"]) for t in told] == [
        ("trouble.node", 3), ("trouble.image", 1)
    ]  # fmt: skip
    times.s += 3600.0
    assert len(screen.snapshot()["troubles"]["open"]) == 2
    assert screen.acknowledge(told[0]["number"])
    assert not screen.acknowledge(told[0]["number"])
    assert [t.said.key for t in screen.troubles.all()] == ["trouble.image"]


def test_an_image_that_waits_for_poses_is_no_trouble_until_it_is_decided(
    screen: Screen, times: Times
) -> None:
    waiting = ImageFact(stamp_ns=5, used=False, reason="no spindle pose", pending=True)
    screen.take_estimate(estimate(times, images=(waiting,)))
    assert screen.troubles.all() == ()
    assert screen.snapshot()["measure"]["refused"] == []
    screen.take_estimate(estimate(times, images=(replace(waiting, pending=False),)))
    assert [t.said.key for t in screen.troubles.all()] == ["trouble.image"]


def test_commands_are_off_while_the_node_that_does_them_is_not_heard(
    screen: Screen, times: Times
) -> None:
    needs = {"start_program", "new_clamping", "corrected", "hand_over"}
    screen.take_part_or_why(part())
    screen.take_allowed(True)
    all_well(screen, times)
    screen.take_estimate(estimate(times))
    assert {name for name in needs if screen.refusals()[name] is not None} == set()
    times.s += 2.0
    assert {name for name in needs if screen.refusals()[name] is not None} == needs


def test_a_real_control_is_not_started_unless_the_bridge_allows_it(
    screen: Screen, times: Times
) -> None:
    all_well(screen, times)
    assert screen.refusals()["start_program"].key == "hand.not_allowed"
    screen.take_allowed(True)
    assert screen.refusals()["start_program"] is None


REFUSED = {
    "no estimate": ({}, None, "hand.no_pose"),
    "revoked": ({}, {"revoked": True}, "hand.no_pose"),
    "not converged": ({}, {"converged": False}, "hand.no_pose"),
    "image pending": ({}, {"images_pending": 1}, "hand.not_judged"),
    "too old": ({}, {"stamp_ns": START_NS - 4_000_000_000_000}, "hand.not_fresh"),
    "from the future": ({}, {"stamp_ns": START_NS + 200_000_000_000}, "hand.not_fresh"),
    "no control": ({"connection": 3}, {}, "hand.not_connected"),
    "takes no offsets": ({"control": "mtconnect"}, {}, "hand.takes_no_offset"),
    "moves": ({"in_position": False}, {}, "hand.not_at_rest"),
    "program runs": ({"program_state": 2}, {}, "hand.program_runs"),
    "program waits": ({"program_state": 3}, {}, "hand.program_runs"),
    "program interrupted": ({"program_state": 4}, {}, "hand.program_runs"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_nothing_is_handed_over_unless_all_conditions_hold(
    screen: Screen, times: Times, case: str
) -> None:
    of_control, of_estimate, key = REFUSED[case]
    screen.take_part_or_why(part())
    screen.take_allowed(True)
    all_well(screen, times)
    screen.take_estimate(estimate(times))
    assert screen.refusals()["hand_over"] is None
    screen.kept.estimate = None if of_estimate is None else estimate(times, **of_estimate)
    screen.take_control(control(**of_control))
    assert screen.refusals()["hand_over"].key == key


def test_a_tilt_that_the_control_cannot_say_is_refused_with_the_reason(
    screen: Screen, times: Times
) -> None:
    screen.take_part_or_why(part())
    screen.take_allowed(True)
    all_well(screen, times)
    screen.take_estimate(estimate(times, (2e-3, -3e-3, 4e-3, 812.345, -410.25, 155.02, 0.0)))
    why = screen.refusals()["hand_over"]
    assert why is not None
    assert "tilt" in why.in_language("en")
    assert screen.snapshot()["hand"]["words"] == []


def test_an_uncertainty_that_is_too_large_asks_for_a_better_measurement_first(
    times: Times,
) -> None:
    wide = np.array([3e-5, 1e-6, 1e-6, 0.1, 0.1, 0.1, 1e-6])
    near = estimate(times, (4e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), expanded_uncertainty=wide)
    found = rows(near, part())
    assert found[0].decision.state == "not proven"
    assert advice(found) == "measure"
    sharp = estimate(times, (7e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert advice(rows(sharp, part())) == "correct"
    assert advice(rows(estimate(times), part())) == "good"


def test_a_deviation_of_an_angle_is_the_short_way_round(times: Times) -> None:
    nominal = Nominal(translation_mm=(None,) * 3, euler_xyz_rad=(0.0, 0.0, 3.1415))
    turned = part(nominal=nominal, tolerances={"gamma_rad": 1e-3})
    found = rows(estimate(times, (0.0, 0.0, -3.1415, 0, 0, 0, 0)), turned)
    assert found[2].decision.deviation == pytest.approx(2 * (np.pi - 3.1415), abs=1e-12)


@pytest.mark.parametrize("gamma", [0.3, 1.6, -2.9])
def test_a_part_is_aligned_in_three_corrections_from_5_mm_per_m(times: Times, gamma: float) -> None:
    """The machine is turned by rigid turns, not by the formula's linear ones."""
    truth = RigidTransform.from_euler_xyz_rad(5e-3, -5e-3, gamma, [800.0, -400.0, 7.0])
    rng = np.random.default_rng(7)
    corrections = 0
    while corrections <= 3:
        theta = [*truth.euler_xyz_rad(), *truth.translation_mm, 0.0]
        measured = estimate(times, theta + rng.normal(0, 1e-6, 7))
        if advice(rows(measured, part())) == "good":
            break
        found = corrections_in_all_modes(measured, part(), JACKS[:3], np.array([0.0, 0.0, 1.0]))
        corrections += 1
        truth = lifted_by_command(
            truth,
            [
                {"x_mm": jack.xyz_mm[0], "y_mm": jack.xyz_mm[1], "mm": correction.correction_mm}
                for jack, correction in zip(JACKS[:3], found["exact"])
            ],
        )
    assert corrections <= 3
    assert np.all(np.abs(truth.euler_xyz_rad()[:2]) <= 5e-5)


@pytest.mark.parametrize("gamma", [0.0, 0.5, -2.0])
def test_jacks_of_the_part_file_stand_in_the_parts_frame(times: Times, gamma: float) -> None:
    """So c = -(dz + α y - β x) holds with θ's own angles, however the part is turned."""
    alpha, beta, dz = 1e-4, -2e-4, -0.3
    fact = estimate(times, (alpha, beta, gamma, 0, 0, dz, 0))
    found = corrections_in_all_modes(fact, part(), JACKS, np.array([0.0, 0.0, 1.0]))
    expected = [-(dz + alpha * j.xyz_mm[1] - beta * j.xyz_mm[0]) for j in JACKS]
    assert [c.correction_mm for c in found["exact"]] == pytest.approx(expected, abs=1e-6)


def test_jacks_have_the_signs_of_the_facts(times: Times) -> None:
    level = {"alpha": (1e-3, 0), "beta": (0, 1e-3)}
    expected = {"alpha": [1, 1, -1, -1], "beta": [-4, 4, 4, -4]}
    for name, (alpha, beta) in level.items():
        fact = estimate(times, (alpha, beta, 0, 0, 0, 0, 0))
        found = corrections_in_all_modes(fact, part(), JACKS, np.array([0.0, 0.0, 1.0]))
        assert [c.correction_mm for c in found["exact"]] == pytest.approx(expected[name], abs=1e-5)
    low = estimate(times, (0, 0, 0, 0, 0, -0.3, 0))
    found = corrections_in_all_modes(low, part(), JACKS, np.array([0.0, 0.0, 1.0]))
    assert [c.correction_mm for c in found["exact"]] == pytest.approx([0.3] * 4)
    assert [c.correction_mm for c in found["tilt"]] == pytest.approx([0.0] * 4, abs=1e-12)


def test_the_uncertainty_of_a_jack_is_of_the_same_kind_as_the_results(times: Times) -> None:
    """One jack above another decides α alone; U of the result is larger than two sigma."""
    wide = estimate(times, expanded_uncertainty=np.array([6e-6] * 3 + [6e-3] * 3 + [6e-6]))
    found = corrections_in_all_modes(wide, part(), JACKS, np.array([0.0, 0.0, 1.0]))
    # tilt only: c = -(α y - β x), with U(α) = U(β) = 6 µrad
    expected = [6e-6 * np.hypot(*jack.xyz_mm[:2]) for jack in JACKS]
    assert [c.expanded_uncertainty_mm for c in found["tilt"]] == pytest.approx(expected)


def test_the_history_holds_before_and_after_of_each_clamping(screen: Screen, times: Times) -> None:
    screen.take_part_or_why(part())
    all_well(screen, times)
    screen.take_estimate(estimate(times, (1e-3, 0, 0, 0, 0, 0, 0)))
    screen.take_estimate(estimate(times, (1.1e-3, 0, 0, 0, 0, 0, 0)))
    screen.corrected("tilt")
    screen.take_estimate(estimate(times, clamping=1, determined=False, revoked=True))
    screen.take_estimate(estimate(times, (1e-5, 0, 0, 0, 0, 0, 0), clamping=1))
    entries = screen.history.to_json_list()
    assert [round(e["rows"][0]["value"], 4) for e in entries] == [1.1, 0.01]
    assert [e["mode"] for e in entries] == ["tilt", ""]
    assert [j["name"] for j in entries[0]["jacks"]] == ["J1", "J2", "J3", "J4"]


def test_the_state_stays_small_however_many_images_there_are(screen: Screen, times: Times) -> None:
    images = tuple(
        ImageFact(stamp_ns=k, used=k % 2 == 0, reason="x" * (k % 2)) for k in range(5000)
    )
    screen.take_estimate(estimate(times, images=images))
    shown = screen.snapshot()
    assert (shown["measure"]["images"], shown["measure"]["used"]) == (5000, 2500)
    assert shown["measure"]["refused"][-1]["number"] == 5000
    assert len(json.dumps(shown)) < 100_000


def test_how_many_stops_a_program_has_is_learned_from_its_first_whole_run(
    screen: Screen, times: Times
) -> None:
    for state, done in ((1, 0), (2, 0), (3, 1), (2, 1), (3, 7), (2, 8), (5, 8)):
        screen.take_control(control(program_state=state, measure_acknowledged=done))
    assert screen.snapshot()["measure"]["stops"] == 8


BAD = [
    b"", b"[]", b"{}", b"null", b"[" * 3000, b"\xff",
    b'{"command": "rm", "key": "12345678"}',
    b'{"command": "new_clamping", "key": "short"}',
    b'{"command": "new_clamping", "key": "../../etc"}',
    b'{"command": "new_clamping", "key": "12345678", "arguments": {"part_file": "/etc/passwd"}}',
    b'{"command": "new_clamping", "key": "12345678", "more": 1}',
    b'{"command": "acknowledge", "key": "12345678", "arguments": {"number": true}}',
    b'{"command": "acknowledge", "key": "12345678", "arguments": {"number": 1e3}}',
    b'{"command": "corrected", "key": "12345678", "arguments": {"mode": "G10 L2"}}',
    b'{"command": "corrected", "key": "12345678", "arguments": {"mode": ["exact"]}}',
    b'{"command": "set_jacks", "key": "12345678", "arguments": {"jacks": "all"}}',
    b'{"command": "set_jacks", "key": "12345678", "arguments": {"jacks": [{"name": "a"}]}}',
]  # fmt: skip


@pytest.mark.parametrize("body", BAD)
def test_what_is_no_command_is_refused_whatever_it_is(body: bytes) -> None:
    with pytest.raises(InputError):
        parse(body)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e9", "true", '"5"', "null"])
def test_a_jack_stands_at_a_number_within_reach(value: str) -> None:
    jack = '{"name": "J%d", "x_mm": %s, "y_mm": 1}'
    jacks = ", ".join([jack % (1, "0"), jack % (2, "1"), jack % (3, value)])
    with pytest.raises(InputError):
        parse(f'{{"command": "set_jacks", "key": "12345678", "arguments": {{"jacks": [{jacks}]}}}}'
              .encode())  # fmt: skip


def test_every_command_has_a_rule_for_when_it_is_off(screen: Screen) -> None:
    for name in COMMANDS:
        screen.refusal(Command(name=name, key="12345678"))
    assert {*screen.refusals(), "acknowledge"} == set(COMMANDS)
