"""Find, identify and centre the ring-coded targets of an image.

    detection = detect_targets(image, TargetFamily.by_name("metashape12"))

Candidates (`candidates`) are centred (`dot_fit`), their rings read (`ring`), and those with a code
of the family centred once more, now with the light on the ring's bright sectors. What looks like a
target but is not certain is refused, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.targets.families import TargetFamily

_BINS = (
    "right",
    "lower right",
    "below",
    "lower left",
    "left",
    "upper left",
    "above",
    "upper right",
)


@dataclass(frozen=True, kw_only=True)
class DetectionOptions:
    """What is looked for.

    Attributes
    ----------
    polarity : "bright", "dark" or "both"
        Dots brighter than their surroundings (retroreflective film), darker (print), or both.
    smallest_dot_px, largest_dot_px : float
        Limits of the dot's major axis.
    contrast_dn : float
        Least contrast of a dot, in grey values of 8 bit (scaled for deeper images).
    largest_disturbance : float
        Refused above this deviation of a part of the dot's edge, in units of the contrast.
    """

    polarity: str = "both"
    smallest_dot_px: float = 7.0
    largest_dot_px: float = 160.0
    contrast_dn: float = 14.0
    largest_disturbance: float = 0.06

    def __post_init__(self) -> None:
        if self.polarity not in ("bright", "dark", "both"):
            raise InputError(
                f"Expected the polarity 'bright', 'dark' or 'both', got {self.polarity!r}."
            )
        if not 4.0 <= self.smallest_dot_px < self.largest_dot_px:
            raise InputError(
                "Expected 4 <= smallest_dot_px < largest_dot_px, got "
                f"{self.smallest_dot_px} and {self.largest_dot_px}."
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectedTarget:
    """A target that was found and identified.

    Attributes
    ----------
    id : int
        Number in the family.
    center_px : (2,) array
        (col, row) of the centre of the dot's image (an ellipse); (0, 0) is the centre of the
        top-left pixel.
    covariance_px2 : (2, 2) array
    diameter_px : float
        Geometric mean of the ellipse's axes.
    axes_px : (major, minor) lengths
    angle_rad : of the major axis, clockwise from the image's columns
    polarity : "bright" or "dark"
    contrast_dn, blur_px : of the dot's edge
    misfit : mean squared residual over the noise; 1 where the dot is as it should be
    """

    id: int
    center_px: NDArray[np.float64]
    covariance_px2: NDArray[np.float64]
    diameter_px: float
    axes_px: tuple[float, float]
    angle_rad: float
    polarity: str
    contrast_dn: float
    blur_px: float
    misfit: float


@dataclass(frozen=True, kw_only=True)
class RefusedTarget:
    """Something that looks like a target and is not certain."""

    center_px: tuple[float, float]
    diameter_px: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class Detection:
    """What was found in one image; targets by number, then by place."""

    targets: tuple[DetectedTarget, ...]
    refused: tuple[RefusedTarget, ...]


def detect_targets(
    image: NDArray[np.generic],
    family: TargetFamily,
    options: DetectionOptions | None = None,
) -> Detection:
    """Find all targets of a family in an image.

    Parameters
    ----------
    image : (height, width) uint8 or uint16
    family : the family that is on the part; another one's codes would be read as wrong numbers

    Raises
    ------
    InputError
        The image is none of one channel and 8 or 16 bit.
    """
    from omm_core.targets.candidates import find_candidates

    options = options or DetectionOptions()
    image = _checked(image)
    full = 255.0 if image.dtype == np.uint8 else float(max(255, int(image.max())))
    scale = full / 255.0
    candidates = find_candidates(
        image,
        threshold=max(options.contrast_dn * scale, 5.0 * noise_level(image)),
        smallest_px=options.smallest_dot_px,
        largest_px=options.largest_dot_px,
        bright=options.polarity != "dark",
        dark=options.polarity != "bright",
    )
    targets: list[DetectedTarget] = []
    refused: list[RefusedTarget] = []
    reader = _Reader(image, family, options, full)
    for candidate in candidates:
        found = reader.read(candidate)
        if isinstance(found, DetectedTarget):
            targets.append(found)
        elif found is not None:
            refused.append(found)
    return Detection(
        targets=tuple(sorted(targets, key=lambda t: (t.id, *t.center_px))),
        refused=tuple(sorted(refused, key=lambda t: t.center_px)),
    )


def noise_level(image: NDArray[np.generic]) -> float:
    """Standard deviation of the image's noise, in grey values, from every 16th row.

    From second differences along the row, whose median does not mind edges.
    """
    rows = image[8::16, ::4].astype(np.float32)
    if rows.shape[1] < 3 or rows.size == 0:
        return 0.0
    second = np.abs(rows[:, :-2] - 2.0 * rows[:, 1:-1] + rows[:, 2:])
    return float(np.median(second)) / (0.6745 * np.sqrt(6.0))


def _checked(image: NDArray[np.generic]) -> NDArray[np.generic]:
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"Expected an image (height, width) of uint8 or uint16, got {image.shape} of "
            f"{image.dtype}: convert it to one channel."
        )
    return np.ascontiguousarray(image)


class _Reader:
    """Turns candidates of one image into targets."""

    def __init__(
        self,
        image: NDArray[np.generic],
        family: TargetFamily,
        options: DetectionOptions,
        full: float,
    ) -> None:
        self._image = image
        self._family = family
        self._options = options
        self._saturation = full - 0.5
        self._dot = np.zeros(17)
        self._unknown = np.full(family.bits, -1, dtype=np.int64)
        self._sectors = np.zeros(family.bits, dtype=np.int64)
        self._figures = np.zeros(4)

    def read(self, candidate: NDArray[np.float64]) -> DetectedTarget | RefusedTarget | None:
        """A target, a refusal, or None where nothing speaks for a target."""
        from omm_core.targets import dot_fit as c
        from omm_core.targets import ring

        sign = float(candidate[7])
        if self._fit(candidate[:7], sign, 0.9, self._unknown, 0.0) != c.OK:
            return None
        dot, family = self._dot, self._family
        status = ring.read_ring(
            self._image, *dot[:5], sign, dot[c.HIGH], dot[c.LOW], dot[c.SIGMA],
            family.ring_inner_ratio, family.ring_outer_ratio, family.bits, self._sectors,
            self._figures,
        )  # fmt: skip
        if status in (ring.UNEVEN, ring.NOT_CLEAR):
            return None
        if status != ring.READ:
            return self._refuse(_RING_REASONS[status])
        number = family.id_of(int("".join(map(str, self._sectors)), 2))
        if number is None:
            return self._refuse(f"its ring carries no code of {family.name}")
        start = dot[[c.COL, c.ROW, c.L11, c.L12, c.L22, c.HIGH, c.LOW]]
        if self._fit(start, sign, dot[c.SIGMA], self._sectors, self._figures[0]) != c.OK:
            return self._refuse("its dot could not be centred")
        return self._judge(number, sign)

    def _fit(
        self,
        start: NDArray[np.float64],
        sign: float,
        blur_px: float,
        sectors: NDArray[np.int64],
        angle: float,
    ) -> int:
        from omm_core.targets.dot_fit import fit_dot

        saturation = self._saturation if sign > 0 else -0.5
        family = self._family
        return int(
            fit_dot(
                self._image, np.ascontiguousarray(start), sign, blur_px, saturation,
                family.ring_inner_ratio, family.ring_outer_ratio, sectors, angle, self._dot,
            )
        )  # fmt: skip

    def _judge(self, number: int, sign: float) -> DetectedTarget | RefusedTarget:
        from omm_core.targets import dot_fit as c

        dot = self._dot
        contrast = float(dot[c.HIGH] - dot[c.LOW])
        limit = self._options.largest_disturbance
        noise_of_mean = 4.0 * np.sqrt(dot[c.NOISE_HIGH] / _pixels_per_sector(dot)) / contrast
        if abs(dot[c.WORST_VALUE]) > limit + noise_of_mean:
            side = _BINS[round(dot[c.WORST_SECTOR] / c.SECTORS * len(_BINS)) % len(_BINS)]
            what = "brighter" if dot[c.WORST_VALUE] * sign > 0 else "darker"
            return self._refuse(
                f"number {number}: the edge of its dot is {what} than it should be ({side}): a "
                "reflection, a chip or dirt"
            )
        covariance = np.array([[dot[c.VAR_COL], dot[c.COVAR]], [dot[c.COVAR], dot[c.VAR_ROW]]])
        L = np.array([[dot[c.L11], dot[c.L12]], [0.0, dot[c.L22]]])
        _, inverse_axes, directions = np.linalg.svd(L)
        major, minor = 2.0 / inverse_axes[1], 2.0 / inverse_axes[0]
        return DetectedTarget(
            id=number,
            center_px=dot[[c.COL, c.ROW]].copy(),
            covariance_px2=covariance,
            diameter_px=float(np.sqrt(major * minor)),
            axes_px=(float(major), float(minor)),
            angle_rad=float(np.arctan2(directions[1, 1], directions[1, 0])),
            polarity="bright" if sign > 0 else "dark",
            contrast_dn=contrast,
            blur_px=float(dot[c.SIGMA]),
            misfit=float(dot[c.MISFIT]),
        )

    def _refuse(self, reason: str) -> RefusedTarget:
        dot = self._dot
        return RefusedTarget(
            center_px=(float(dot[0]), float(dot[1])),
            diameter_px=float(2.0 / np.sqrt(dot[2] * dot[4])),
            reason=reason,
        )


def _pixels_per_sector(dot: NDArray[np.float64]) -> float:
    from omm_core.targets.dot_fit import SECTORS, SIGMA

    circumference = 2.0 * np.pi / np.sqrt(dot[2] * dot[4])
    return float(max(1.0, circumference * 4.0 * dot[SIGMA] / SECTORS))


# By the status of `ring.read_ring`.
_RING_REASONS = {
    3: "its ring looks like no code: covered in part, or no target",
    4: "its ring could be read in two ways: too small, too blurred or too noisy",
    5: "its ring leaves the image",
}
