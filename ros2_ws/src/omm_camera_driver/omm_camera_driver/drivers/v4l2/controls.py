"""Controls of a V4L2 device, by name: found, checked against their ranges, set, read back."""

import re
from collections.abc import Container
from dataclasses import dataclass

from omm_camera_driver.driver import check_range
from omm_camera_driver.drivers.v4l2 import videodev
from omm_core.errors import DeviceError, InputError

# The names that drivers use, first the ones of today's kernels.
_EXPOSURE = ("exposure_time_absolute", "exposure_absolute")
_EXPOSURE_STEP_US = 100.0  # V4L2_CID_EXPOSURE_ABSOLUTE counts in 100 µs
_GAIN = ("gain", "analogue_gain")
_MIRRORS = ("horizontal_flip", "vertical_flip")
_AUTOMATICS = {
    "exposure_us": (("auto_exposure", 1), ("exposure_auto", 1)),  # 1 is "manual"
    "gain": (("autogain", 0), ("gain_automatic", 0)),
}


@dataclass(frozen=True, kw_only=True)
class FoundControl:
    """A control that the device has."""

    id: int
    name: str
    type: int
    minimum: int
    maximum: int


def control_name(told: str) -> str:
    """Return the name as v4l2-ctl writes it.

    `Exposure Time, Absolute` becomes exposure_time_absolute.
    """
    return re.sub(r"[^a-z0-9]+", "_", told.lower()).strip("_")


class Controls:
    """The controls of an opened device."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.found = {control.name: control for control in _enumerate(fd)}

    def set_named(self, name: str, value: int) -> int:
        """Set a control and return what it became.

        Raises
        ------
        InputError
            There is no such control, or it does not take this value.
        """
        control = self.found.get(name)
        if control is None:
            raise InputError(
                f"Expected one of the controls {', '.join(sorted(self.found))}, got {name}."
            )
        if control.type != videodev.CONTROL_BUTTON:
            check_range(name, value, control.minimum, control.maximum)
        try:
            videodev.call(self._fd, videodev.S_CTRL, videodev.Control(control.id, value))
        except videodev.DeviceLost:
            raise
        except DeviceError as error:
            raise InputError(f"Control {name} does not take {value}: {error}") from error
        return value if control.type == videodev.CONTROL_BUTTON else self.get(name)

    def take_back(self, keep: Container[str]) -> tuple[str, ...]:
        """Undo a mirroring of a former user, which no target survives; return what was told."""
        notes = []
        for name in _MIRRORS:
            if name in self.found and name not in keep and self.get(name):
                now = self.set_named(name, 0)
                notes.append(f"{name} was 1, left by a former user; it is {now} now.")
        return tuple(notes)

    def get(self, name: str) -> int:
        """Return the value of a control."""
        control = videodev.Control(self.found[name].id, 0)
        return int(videodev.call(self._fd, videodev.G_CTRL, control).value)

    def set(self, name: str, value: float) -> float:
        """Set `exposure_us` or `gain`, after switching automatic control off."""
        names, step = (_EXPOSURE, _EXPOSURE_STEP_US) if name == "exposure_us" else (_GAIN, 1.0)
        control = next((self.found[n] for n in names if n in self.found), None)
        if control is None:
            raise InputError(
                f"Expected {name} to be left unset: this device has no control "
                f"{' or '.join(names)}. Set one of its own with the parameter controls: "
                f"{', '.join(sorted(self.found))}."
            )
        unit = "µs" if name == "exposure_us" else ""
        check_range(name, value, control.minimum * step, control.maximum * step, unit)
        for automatic, off in _AUTOMATICS[name]:
            if automatic in self.found:
                self.set_named(automatic, off)
        return self.set_named(control.name, round(value / step)) * step

    def exposure_ns(self) -> int:
        """Return the exposure time, 0 where the device does not tell it."""
        for name in _EXPOSURE:
            if name in self.found:
                return round(self.get(name) * _EXPOSURE_STEP_US * 1000)
        return 0


def _enumerate(fd: int) -> list[FoundControl]:
    found: list[FoundControl] = []
    usable = (
        videodev.CONTROL_INTEGER, videodev.CONTROL_BOOLEAN, videodev.CONTROL_MENU,
        videodev.CONTROL_BUTTON, videodev.CONTROL_INTEGER_MENU,
    )  # fmt: skip
    query = videodev.ControlDescription(id=videodev.CONTROL_NEXT)
    while True:
        try:
            videodev.call(fd, videodev.QUERYCTRL, query)
        except videodev.DeviceLost:
            raise
        except DeviceError:  # that was the last one
            return found
        if query.type in usable and not query.flags & videodev.CONTROL_DISABLED:
            name = control_name(query.name.decode("utf-8", "replace"))
            found.append(
                FoundControl(
                    id=query.id, name=name, type=query.type, minimum=query.minimum,
                    maximum=query.maximum,
                )
            )  # fmt: skip
        query = videodev.ControlDescription(id=query.id | videodev.CONTROL_NEXT)
