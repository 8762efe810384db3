"""What a former user left on in a camera, and a measuring camera must not have.

A calibration holds for pixels as the sensor has them, and exposures as they are asked for.
"""

from collections.abc import Container
from typing import Protocol

from omm_camera_driver.driver import CameraSettings
from omm_core.errors import DeviceError

Value = bool | int | str

NEUTRAL: dict[str, Value] = {
    "BinningHorizontal": 1, "BinningVertical": 1, "DecimationHorizontal": 1,
    "DecimationVertical": 1, "ReverseX": False, "ReverseY": False, "ChunkModeActive": False,
    "TestPattern": "Off", "SequencerMode": "Off", "ExposureMode": "Timed",
}  # fmt: skip
"""Features by their standard names, and what they must be; named in `controls`, they stay."""
_AUTOMATICS = {"exposure_us": "ExposureAuto", "gain": "GainAuto"}


class Features(Protocol):
    """The features of an opened camera."""

    def has(self, feature: str) -> bool:
        """Return whether the camera has a feature, and it can be used now."""
        ...

    def get(self, feature: str, kind: type[Value]) -> Value:
        """Return the value of a feature."""
        ...

    def put(self, feature: str, value: Value) -> None:
        """Set a feature."""
        ...


def take_back(camera: Features, *, keep: Container[str]) -> tuple[str, ...]:
    """Make every such feature neutral; return what was told of those that were not."""
    notes = (
        _take_back(camera, feature, neutral)
        for feature, neutral in NEUTRAL.items()
        if feature not in keep and camera.has(feature)
    )
    return tuple(note for note in notes if note)


def _take_back(camera: Features, feature: str, neutral: Value) -> str:
    try:
        found = camera.get(feature, type(neutral))
        if found == neutral:
            return ""
        camera.put(feature, neutral)
    except DeviceError as error:
        return f"{feature} could not be made sure of: {error}"
    return f"{feature} was {found}, left by a former user; it is {neutral} now."


def left_automatic(camera: Features, settings: CameraSettings) -> list[str]:
    """Return what the camera changes by itself, since nobody asked for a value."""
    notes = []
    for name, feature in _AUTOMATICS.items():
        asked_for = getattr(settings, name) is not None or feature in settings.controls
        if asked_for or not camera.has(feature):
            continue
        automatic = camera.get(feature, str)
        if automatic != "Off":
            notes.append(
                f"{feature} is {automatic}: the camera changes it from image to image. "
                f"Set {name} for images that are alike."
            )
    return notes
