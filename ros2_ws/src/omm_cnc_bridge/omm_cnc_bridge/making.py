"""Judge and handshake as the parameters ask for them."""

from __future__ import annotations

from omm_cnc_bridge.handshake import Handshake, HandshakeLimits
from omm_cnc_bridge.judgement import Judge, Reported, SampleLimits
from omm_cnc_bridge.leading import Leading
from omm_cnc_bridge.parameters import Parameters
from omm_cnc_bridge.standstill import StandStillLimits
from omm_core.machine.kinematics import Kinematics


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


def make_judge(p: Parameters, machine: Kinematics) -> Judge:
    """Return the judge of samples, with the limits that the parameters give."""
    still = StandStillLimits(
        tolerance_mm=p.tolerance_mm,
        tolerance_rad=p.tolerance_rad,
        dwell_ns=_ns(p.dwell_s),
        gap_ns=_ns(p.gap_s),
    )
    limits = SampleLimits(
        age_ns=_ns(p.max_age_s), stamp_uncertainty_ns=_ns(p.max_stamp_uncertainty_s)
    )
    return Judge(
        machine,
        still,
        limits,
        reported=Reported(p.reported),
        tool_length_mm=p.tool_length_mm,
    )


def make_handshake(p: Parameters, leading: Leading, acknowledged: int = 0) -> Handshake:
    """Return the handshake for images, which goes on after the last acknowledged one."""
    limits = HandshakeLimits(
        trigger_timeout_ns=_ns(p.trigger_timeout_s),
        attempts=p.trigger_attempts,
        retry_ns=_ns(p.retry_s),
        hold_ns=_ns(p.hold_after_image_s),
    )
    handshake = Handshake(limits, leading.is_ready)
    handshake.acknowledged = acknowledged
    return handshake
