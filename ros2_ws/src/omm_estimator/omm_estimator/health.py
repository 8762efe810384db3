"""What the estimator says of its health: of the images it was given, and of the estimate."""

from __future__ import annotations

from collections.abc import Sequence

from omm_core.session.result import MeasurementResult
from omm_core.words import Words, keyed, sentences
from omm_ros.diagnostics import ERROR, OK, WARN, Health

_NOT_CONFIGURED = keyed("said.not_configured", "not configured")
_TOLD = 20


def image_health(
    result: MeasurementResult | None,
    *,
    bad_poses: int,
    missed_images: int,
    trouble: Sequence[str],
) -> Health:
    """Return how many images are used, and what is in the way of more.

    Parameters
    ----------
    result : MeasurementResult or None
        None before a part was measured at all.
    bad_poses : int
        Poses that could not be used.
    missed_images : int
        Images that came faster than targets are found.
    trouble : sequence of str
        Why nothing may come at the moment.
    """
    if result is None:
        return Health(level=WARN, message=_NOT_CONFIGURED)
    refused = [image for image in result.images if not image.used]
    values: dict[str, object] = {f"refused {i.stamp_ns}": i.reason for i in refused[-_TOLD:]}
    values |= {"images": len(result.images), "pending": result.images_pending}
    values["bad poses"], values["missed images"] = bad_poses, missed_images
    used = keyed(
        "said.images_used",
        "{used} of {n} images used",
        used=len(result.images) - len(refused),
        n=len(result.images),
    )
    return Health(
        level=WARN if refused or bad_poses or missed_images or trouble else OK,
        message=sentences([used, *trouble]),
        values=values,
    )


def estimate_health(result: MeasurementResult | None, preparing: Words) -> Health:
    """Return whether there is a pose, and what is found wrong or missing.

    Parameters
    ----------
    result : MeasurementResult or None
        None before a part was measured at all.
    preparing : Words
        What the node still waits for; empty where it waits for nothing.
    """
    if preparing:
        return Health(level=WARN, message=preparing)
    if result is None or not result.images:
        return Health(level=OK, message=keyed("said.no_image", "no image yet"))
    if not result.determined:
        return Health(
            level=WARN,
            message=sentences(result.missing) or keyed("said.not_determined", "not determined"),
        )
    if result.findings:
        return Health(level=ERROR, message=sentences(result.findings))
    return Health(
        message=keyed(
            "said.determined",
            "determined, residuals {px} px RMS",
            px=f"{result.solution.rms_px:.4f}",
        )
    )
