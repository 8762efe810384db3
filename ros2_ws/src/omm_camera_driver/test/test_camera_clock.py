"""The camera's clock in system time: the truth lies within the bound, always."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from omm_camera_driver.drivers.genicam.camera_clock import CameraClock, ClockReading

BOOT_NS = 1_700_000_000_000_000_000


def reading(at_ns: int, before_ns: int, after_ns: int) -> ClockReading:
    """Of a clock that began at BOOT_NS, latched somewhere between the two."""
    return ClockReading(
        camera_ns=at_ns - BOOT_NS, after_ns=at_ns - before_ns, before_ns=at_ns + after_ns
    )


@given(
    st.lists(
        st.tuples(st.integers(0, 5_000_000), st.integers(0, 5_000_000)), min_size=1, max_size=8
    ),
    st.integers(0, 3_600_000_000_000),
)
def test_the_truth_is_within_the_bound(delays: list[tuple[int, int]], later_ns: int) -> None:
    clock = CameraClock()
    for i, (before_ns, after_ns) in enumerate(delays):
        clock.add_reading(reading(BOOT_NS + 10**9 + i * 10**7, before_ns, after_ns))
    truth_ns = BOOT_NS + 2 * 10**9 + later_ns
    told_ns, bound_ns = clock.exposure_begin(truth_ns - BOOT_NS, truth_ns + 1, 0)
    assert abs(told_ns - truth_ns) <= bound_ns + 1


@given(st.integers(-100, 100), st.integers(0, 600))
def test_a_drifting_clock_stays_within_the_bound(drift_ppm: int, age_s: int) -> None:
    clock = CameraClock()
    clock.add_reading(reading(BOOT_NS + 10**9, 100_000, 200_000))
    truth_ns = BOOT_NS + 10**9 + age_s * 10**9
    drifted_ns = age_s * 10**9 * drift_ppm // 1_000_000
    told_ns, bound_ns = clock.exposure_begin(truth_ns - BOOT_NS + drifted_ns, truth_ns + 10**8, 0)
    # The bound itself is of the drifted clock: a part in ten thousand of the drift is left over.
    assert abs(told_ns - truth_ns) <= bound_ns * 1.001 + 1


def test_a_tight_reading_is_kept_until_it_is_older_than_a_loose_one() -> None:
    clock = CameraClock()
    clock.add_reading(reading(BOOT_NS + 10**9, 10_000, 10_000))
    clock.add_reading(reading(BOOT_NS + 2 * 10**9, 1_000_000, 1_000_000))
    _, after_1_s = clock.exposure_begin(2 * 10**9, BOOT_NS + 2 * 10**9, 0)
    assert after_1_s < 200_000
    clock.add_reading(reading(BOOT_NS + 60 * 10**9, 1_000_000, 1_000_000))
    _, after_60_s = clock.exposure_begin(60 * 10**9, BOOT_NS + 60 * 10**9, 0)
    assert after_60_s < 1_100_000


def test_without_readings_the_fastest_arrival_counts() -> None:
    clock = CameraClock()
    exposure_ns = 4_000_000
    for i, transfer_ns in enumerate((9_000_000, 2_000_000, 30_000_000)):
        begin_ns = BOOT_NS + i * 66_000_000
        told_ns, bound_ns = clock.exposure_begin(
            begin_ns - BOOT_NS, begin_ns + exposure_ns + transfer_ns, exposure_ns
        )
    assert told_ns == begin_ns + exposure_ns // 2 + 2_000_000
    assert bound_ns == 28_000_000 + exposure_ns // 2
    assert clock.told() == "from arrivals"


def test_a_camera_that_does_not_stamp_is_judged_by_each_arrival() -> None:
    """Not by the earliest arrival ever, which would give every image the same stamp."""
    clock = CameraClock()
    for i in range(5):
        begin_ns = BOOT_NS + i * 10**9
        told_ns, bound_ns = clock.exposure_begin(0, begin_ns + 14_000_000, 4_000_000)
        assert abs(told_ns - begin_ns) <= bound_ns
    assert clock.told() == "none"


@pytest.mark.parametrize("unit", [8, 1000])
def test_images_counted_in_another_unit_than_the_clock_cannot_be(unit: int) -> None:
    clock = CameraClock()
    uptime_ns = 60 * 10**9
    clock.add_reading(reading(BOOT_NS + uptime_ns, 10_000, 10_000))
    arrival_ns = BOOT_NS + uptime_ns + 40_000_000
    assert clock.can_be(uptime_ns, arrival_ns, 5_000_000)
    assert not clock.can_be(uptime_ns // unit, arrival_ns, 5_000_000)
    assert not clock.can_be(uptime_ns * unit, arrival_ns, 5_000_000)


def test_a_clock_that_is_not_believed_is_left_for_the_arrivals() -> None:
    clock = CameraClock()
    clock.add_reading(reading(BOOT_NS + 10**9, 10_000, 10_000))
    clock.distrust()
    clock.add_reading(reading(BOOT_NS + 10**9, 10_000, 10_000))
    begin_ns = BOOT_NS + 2 * 10**9
    told_ns, bound_ns = clock.exposure_begin(77, begin_ns + 5_000_000, 4_000_000)
    assert abs(told_ns - begin_ns) <= bound_ns
    assert "reads other than it stamps" in clock.told()


def test_a_reading_that_contradicts_the_last_replaces_it_however_loose() -> None:
    clock = CameraClock()
    clock.add_reading(reading(BOOT_NS + 10**9, 10_000, 10_000))
    step_ns = 20_000_000  # PTP set the camera's clock
    late = reading(BOOT_NS + 2 * 10**9, 1_000_000, 1_000_000)
    clock.add_reading(
        ClockReading(
            camera_ns=late.camera_ns + step_ns, after_ns=late.after_ns, before_ns=late.before_ns
        )
    )
    truth_ns = BOOT_NS + 2 * 10**9
    told_ns, bound_ns = clock.exposure_begin(2 * 10**9 + step_ns, truth_ns + 10**7, 0)
    assert abs(told_ns - truth_ns) <= bound_ns
