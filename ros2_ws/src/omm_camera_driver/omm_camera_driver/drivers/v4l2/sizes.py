"""How large the images of a device can be, and whether somebody left it at less."""

from collections.abc import Iterable

from omm_camera_driver.driver import CameraSettings, DeviceLost
from omm_camera_driver.drivers.v4l2 import videodev
from omm_core.errors import DeviceError


def smaller_than_it_can(
    fd: int, pix: videodev.PixelFormat, settings: CameraSettings
) -> tuple[str, ...]:
    """Return that a device was left at a small size by a former user; mostly nothing."""
    largest = largest_size(_sizes(fd, pix.pixelformat))
    if settings.width_px or settings.height_px or largest <= pix.width * pix.height:
        return ()
    return (
        f"The device is left at {pix.width} × {pix.height} pixels, and can do more: set "
        "roi_width_px and roi_height_px to the size that it was calibrated with.",
    )


def largest_size(sizes: Iterable[videodev.FrameSize]) -> int:
    """Return the number of pixels of the largest size; 0 where none is told."""
    return max((size.largest[0] * size.largest[1] for size in sizes), default=0)


def _sizes(fd: int, pixel_format: int) -> list[videodev.FrameSize]:
    found: list[videodev.FrameSize] = []
    while True:
        size = videodev.FrameSize(index=len(found), pixel_format=pixel_format)
        try:
            videodev.call(fd, videodev.ENUM_FRAMESIZES, size)
        except DeviceLost:
            raise
        except DeviceError:  # that was the last one, or it does not tell them
            return found
        found.append(size)
        if size.type != videodev.SINGLE_SIZE:  # a range comes alone
            return found
