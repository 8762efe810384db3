"""What is heard of the cell, as the screen takes it: mm and rad, stamps in nanoseconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform

Array = NDArray[np.float64]

# The numbers of omm_interfaces/SpindleState.
CONNECTED = 2
PROGRAM_STATES = ("unknown", "stopped", "running", "waiting", "interrupted", "finished")


@dataclass(frozen=True, kw_only=True)
class ImageFact:
    """What became of one image; ``reason`` is empty where nothing is wrong with it.

    ``pending``: it waits for spindle poses after it, and nothing is decided.
    """

    stamp_ns: int
    used: bool
    reason: str = ""
    pending: bool = False

    @property
    def refused(self) -> bool:
        """Whether it is decided that it cannot be used."""
        return bool(self.reason) and not self.used and not self.pending


@dataclass(frozen=True, kw_only=True)
class ResidualFact:
    """One target in one image: measured centre, computed minus measured (px)."""

    stamp_ns: int
    target_id: int
    center_px: tuple[float, float]
    residual_px: tuple[float, float]
    used: bool
    reason: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimateFact:
    """The newest estimate.

    Attributes
    ----------
    theta : (7,) array
        α, β, γ, x, y, z, γ_s; rad and mm; NaN where not determined.
    covariance : (7, 7) array
        In the order of θ, rad and mm.
    expanded_uncertainty : (7,) array
        U: 95.45 % of errors are smaller.
    stamp_ns : int
        Of the newest image in it.
    shares : mapping
        Part of each variance that comes from what: (7,) for each source; empty where not told.
    """

    part: str
    model: str = "7d"
    determined: bool = False
    converged: bool = False
    theta: Array
    covariance: Array
    expanded_uncertainty: Array
    stamp_ns: int = 0
    rms_px: float = float("nan")
    sigma0: float = float("nan")
    degrees_of_freedom: int = 0
    images: tuple[ImageFact, ...] = ()
    images_pending: int = 0
    targets: tuple[tuple[int, int], ...] = ()
    residuals: tuple[ResidualFact, ...] = ()
    missing: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    clamping: int = 0
    revoked: bool = False
    revoked_reason: str = ""
    shares: Mapping[str, Array] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether there is a pose that still is true."""
        return self.determined and self.converged and not self.revoked

    def machine_T_part(self) -> RigidTransform:
        """Return the part's pose."""
        alpha, beta, gamma = (float(angle) for angle in self.theta[:3])
        return RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, self.theta[3:6])


@dataclass(frozen=True, kw_only=True)
class ControlFact:
    """What the control says of itself."""

    control: str
    connection: int = 0
    detail: str = ""
    program_state: int = 0
    program: str = ""
    program_line: int = -1
    in_position: bool = False
    moving_reason: str = ""
    measure_requested: bool = False
    measure_request: int = 0
    measure_acknowledged: int = 0
    axes: tuple[tuple[str, float], ...] = ()

    @property
    def connected(self) -> bool:
        """Whether fresh data arrive from the control."""
        return self.connection == CONNECTED

    @property
    def program_word(self) -> str:
        """Return the program's state in one word."""
        known = 0 <= self.program_state < len(PROGRAM_STATES)
        return PROGRAM_STATES[self.program_state] if known else "unknown"

    def noteworthy(self) -> tuple[object, ...]:
        """Return what is shown at once when it changes: all but where the axes are."""
        return (
            self.connection, self.program_state, self.program, self.in_position,
            self.measure_requested, self.measure_request, self.measure_acknowledged,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class HealthFact:
    """One line of diagnostics; ``level`` 0 fine, 1 warning, 2 error, 3 stale."""

    node: str
    name: str
    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureFact:
    """The newest picture as it is sent to pages, and the size of the image that it was made of."""

    number: int
    stamp_ns: int
    width_px: int
    height_px: int
    jpeg: bytes


@dataclass(frozen=True, kw_only=True)
class FoundFact:
    """What was found in an image: (id, col, row), and what was refused: (col, row, why)."""

    stamp_ns: int
    targets: tuple[tuple[int, float, float], ...] = ()
    refused: tuple[tuple[float, float, str], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetFact:
    """A work offset as the control has it: its name, x, y, z (mm), and fixed-axis angles (rad)."""

    name: str
    xyz_mm: tuple[float, float, float]
    euler_xyz_rad: tuple[float, float, float]
