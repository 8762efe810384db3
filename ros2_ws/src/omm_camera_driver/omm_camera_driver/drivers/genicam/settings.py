"""Settings of a GenICam camera: applied, checked against its ranges, read back."""

from collections.abc import Callable, Mapping
from ctypes import byref, c_double, c_int, c_int64, c_uint32
from typing import Any

from omm_camera_driver.driver import CameraSettings, Trigger, check_range
from omm_camera_driver.drivers.genicam.aravis import AUTO_OFF, Aravis
from omm_camera_driver.drivers.genicam.left_behind import NEUTRAL, Value, left_automatic, take_back
from omm_camera_driver.pixels import is_read
from omm_core.errors import DeviceError, InputError

_CONTINUOUS_ACQUISITION = 0
# parameter: (Aravis' name, name of the automatic, unit)
_NUMBERS = {
    "exposure_us": ("exposure_time", "exposure", "µs"),
    "gain": ("gain", "gain", ""),
    "black_level": ("black_level", "black_level", ""),
    "frame_rate_hz": ("frame_rate", "", "Hz"),
}
_PTP_FEATURES = (b"PtpEnable", b"GevIEEE1588")
_PTP_STATUS = (b"PtpStatus", b"GevIEEE1588Status")
_TEMPERATURES = (b"DeviceTemperature", b"DeviceTemperatureRaw")
_KINDS: dict[type, str] = {bool: "boolean", int: "integer", str: "string"}
_SIGNED = {"gain": "Gain", "black_level": "BlackLevel"}
_GRANTED_WITHIN = 0.05


class GenicamSettings:
    """The settings of one opened camera."""

    def __init__(self, arv: Aravis, camera: int, device: int) -> None:
        self._arv = arv
        self._camera = camera
        self._device = device

    def apply(self, settings: CameraSettings, *, ptp: bool) -> tuple[str, ...]:
        """Set everything that is asked for, and take back what a former user left on.

        The order matters: binning bounds the region, the region bounds the frame rate.

        Returns
        -------
        tuple of str
            What was taken back.

        Raises
        ------
        InputError
            The camera does not have a setting, or not in this range.
        """
        self._stop()
        notes = take_back(self, keep=settings.controls)
        for name in [name for name in settings.controls if name in NEUTRAL]:
            self._set_control(name, settings.controls[name])
        if settings.pixel_format is not None:
            self._set_pixel_format(settings.pixel_format)
        self._check_pixel_format()
        self._set_region(settings)
        self._set_numbers(settings)
        self._set_trigger(settings)  # after the frame rate, with which Aravis clears triggers
        if settings.strobe_line:
            self._set_strobe(settings.strobe_line)
        for name, value in settings.controls.items():
            if name not in NEUTRAL:
                self._set_control(name, value)
        notes = (*notes, *left_automatic(self, settings), *self._granted_otherwise(settings))
        if ptp:
            self._first_available(_PTP_FEATURES, "PTP", self._enable)
        return notes

    def set(self, name: str, value: float) -> float:
        """Set one of the numbers and return what the camera made of it."""
        if name not in _NUMBERS:
            raise InputError(f"Expected one of {', '.join(_NUMBERS)}, got {name}.")
        feature, automatic, unit = _NUMBERS[name]
        if not self._call(f"camera_is_{feature}_available"):
            raise InputError(f"Expected {name} to be left unset: this camera cannot set it.")
        low, high = c_double(), c_double()
        self._call(f"camera_get_{feature}_bounds", byref(low), byref(high))
        check_range(name, value, low.value, high.value, unit)
        if automatic and self._call(f"camera_is_{automatic}_auto_available"):
            self._call(f"camera_set_{feature}_auto", AUTO_OFF)
        signed = _SIGNED.get(name, "")
        if value < 0.0 and self.has(signed):  # Aravis' own function ignores what is negative
            self._call("camera_set_float", signed.encode(), value)
        else:
            self._call(f"camera_set_{feature}", value)
        return float(self._call(f"camera_get_{feature}"))

    def exposure_ns(self) -> int:
        """Return the exposure time, 0 where the camera does not tell it."""
        if not self._call("camera_is_exposure_time_available"):
            return 0
        return round(self._call("camera_get_exposure_time") * 1000)

    def granted(self) -> dict[str, Any]:
        """Return what the camera is set to, read back."""
        x, y, width, height = c_int(), c_int(), c_int(), c_int()
        self._call("camera_get_region", byref(x), byref(y), byref(width), byref(height))
        values: dict[str, Any] = {
            "region_px": f"{width.value}x{height.value}+{x.value}+{y.value}",
            "pixel_format": (self._call("camera_get_pixel_format_as_string") or b"?").decode(),
        }
        for name, (feature, _, _) in _NUMBERS.items():
            if self._call(f"camera_is_{feature}_available"):
                values[name] = round(self._call(f"camera_get_{feature}"), 3)
        return values

    def health(self) -> Mapping[str, Any]:
        """Return the temperature and the state of PTP, where the camera has them."""
        values: dict[str, Any] = {}
        for feature in _TEMPERATURES:
            if self._call("camera_is_feature_available", feature):
                values["temperature_degc"] = self._number(feature)
                break
        for feature in _PTP_STATUS:
            if self._call("camera_is_feature_available", feature):
                values["ptp"] = (self._call("camera_get_string", feature) or b"").decode()
                break
        return values

    def _number(self, feature: bytes) -> float:
        try:
            return float(self._call("camera_get_float", feature))
        except DeviceError:  # some cameras have it as an integer
            return float(self._call("camera_get_integer", feature))

    def set_integer(self, feature: str, value: int, unit: str = "") -> int:
        """Set an integer feature, checked against its range; return what it became."""
        low, high = c_int64(), c_int64()
        self._call("camera_get_integer_bounds", feature.encode(), byref(low), byref(high))
        check_range(feature, value, low.value, high.value, unit)
        self._call("camera_set_integer", feature.encode(), value)
        return int(self._call("camera_get_integer", feature.encode()))

    def has(self, feature: str) -> bool:
        """Return whether the camera has a feature, and it can be used now."""
        return bool(self._call("camera_is_feature_available", feature.encode()))

    def get(self, feature: str, kind: type[Value]) -> Value:
        """Return the value of a feature: a bool, an int, or the word of an enumeration."""
        found = self._call(f"camera_get_{_KINDS[kind]}", feature.encode())
        return (found or b"").decode() if kind is str else kind(found)

    def put(self, feature: str, value: Value) -> None:
        """Set a feature to a value of its kind."""
        plain = value.encode() if isinstance(value, str) else int(value)
        self._call(f"camera_set_{_KINDS[type(value)]}", feature.encode(), plain)

    def _stop(self) -> None:
        """End what a program that crashed has left running: it locks the settings."""
        try:
            self._call("camera_stop_acquisition")
        except DeviceError:
            # Some cameras refuse to stop while they stand still.
            return

    def _granted_otherwise(self, settings: CameraSettings) -> list[str]:
        """Return what the camera made something else of than was asked for."""
        granted = self.granted()
        asked = {name: getattr(settings, name) for name in _NUMBERS}
        return [
            f"{name}: asked for {value:g}, the camera granted {granted[name]:g}."
            for name, value in asked.items()
            if value is not None and abs(granted[name] - value) > _GRANTED_WITHIN * abs(value)
        ]

    def _set_numbers(self, settings: CameraSettings) -> None:
        """Set exposure, gain and rate; what another of them bounds is tried again after it."""
        wanted = {name: getattr(settings, name) for name in _NUMBERS}
        refused = []
        for name in [name for name, value in wanted.items() if value is not None]:
            try:
                self.set(name, wanted[name])
            except InputError:
                refused.append(name)
        for name in refused:
            self.set(name, wanted[name])

    def _check_pixel_format(self) -> None:
        """Refuse a format that is not read, and name those that are."""
        if is_read(self._call("camera_get_pixel_format")):
            return
        has = (self._call("camera_get_pixel_format_as_string") or b"?").decode()
        count = c_uint32()
        numbers = self._call("camera_dup_available_pixel_formats", byref(count))
        readable = [
            name
            for name, number in zip(self._formats(), numbers[: count.value], strict=True)
            if is_read(number)
        ]
        self._arv.g_free(numbers)
        advice = (
            f"Set pixel_format to one of {', '.join(readable)}." if readable else "It has none."
        )
        raise InputError(
            "Expected a pixel format that is read (Mono8 to Mono16, Bayer, RGB8, BGR8), but the "
            f"camera is set to {has}. {advice}"
        )

    def _formats(self) -> list[str]:
        count = c_uint32()
        names = self._call("camera_dup_available_pixel_formats_as_strings", byref(count))
        known = [names[i].decode() for i in range(count.value)] if names else []
        if names:
            self._arv.g_free(names)
        return known

    def _set_pixel_format(self, name: str) -> None:
        known = self._formats()
        if name not in known:
            raise InputError(f"Expected pixel_format to be one of {', '.join(known)}, got {name}.")
        self._call("camera_set_pixel_format_from_string", name.encode())

    def _set_region(self, settings: CameraSettings) -> None:
        wanted = (
            settings.offset_x_px, settings.offset_y_px, settings.width_px, settings.height_px
        )  # fmt: skip
        if all(value is None for value in wanted):
            return
        self._call("camera_set_region", 0, 0, -1, -1)  # else the offset bounds the size
        (_, most_cols), (_, most_rows) = self._bounds("width"), self._bounds("height")
        x, y = settings.offset_x_px or 0, settings.offset_y_px or 0
        width, height = settings.width_px or most_cols - x, settings.height_px or most_rows - y
        check_range("roi_width_px", width, 1, most_cols, "px")
        check_range("roi_height_px", height, 1, most_rows, "px")
        check_range("roi_x_px", x, 0, most_cols - width, "px")
        check_range("roi_y_px", y, 0, most_rows - height, "px")
        self._call("camera_set_region", x, y, width, height)
        got = (c_int(), c_int(), c_int(), c_int())
        self._call("camera_get_region", *(byref(value) for value in got))
        if tuple(value.value for value in got) != (x, y, width, height):
            raise InputError(
                f"Expected a region that this camera can do, got {width}x{height}+{x}+{y}; the "
                "nearest is {2}x{3}+{0}+{1}.".format(*(value.value for value in got))
            )

    def _bounds(self, name: str) -> tuple[int, int]:
        low, high = c_int(), c_int()
        self._call(f"camera_get_{name}_bounds", byref(low), byref(high))
        return low.value, high.value

    def _set_trigger(self, settings: CameraSettings) -> None:
        self._call("camera_set_acquisition_mode", _CONTINUOUS_ACQUISITION)
        self._call("camera_clear_triggers")
        if settings.trigger is Trigger.HARDWARE:
            if not settings.trigger_line:
                raise InputError("Expected trigger_line (such as Line1) for a hardware trigger.")
            self._call("camera_set_trigger", settings.trigger_line.encode())
        elif settings.trigger is Trigger.SOFTWARE and self._call(
            "camera_is_software_trigger_supported"
        ):
            self._call("camera_set_trigger", b"Software")

    def _set_strobe(self, line: str) -> None:
        """Set an output line to be on during the exposure (SFNC 2: Line… features)."""
        for feature, value in (
            (b"LineSelector", line.encode()),
            (b"LineMode", b"Output"),
            (b"LineSource", b"ExposureActive"),
        ):
            if not self._call("camera_is_feature_available", feature):
                if feature == b"LineMode":  # lines that can be outputs only
                    continue
                raise InputError(
                    f"Expected strobe_line to be left unset: this camera has no {feature.decode()}."
                    " Set its own strobe features with the parameter controls."
                )
            self._call("camera_set_string", feature, value)

    def _set_control(self, name: str, value: str) -> None:
        if not self._call("camera_is_feature_available", name.encode()):
            raise InputError(f"Expected a feature of this camera in controls, got {name}.")
        try:
            self._arv.device_set_features_from_string(self._device, f"{name}={value}".encode())
        except DeviceError as error:
            raise InputError(f"controls: {name}={value} is refused: {error}.") from error

    def _enable(self, feature: bytes) -> None:
        self._call("camera_set_boolean", feature, 1)

    def _first_available(
        self, features: tuple[bytes, ...], what: str, use: Callable[[bytes], None]
    ) -> None:
        for feature in features:
            if self._call("camera_is_feature_available", feature):
                use(feature)
                return
        raise InputError(f"Expected ptp false: this camera has no {what}.")

    def _call(self, name: str, *arguments: Any) -> Any:
        return getattr(self._arv, name)(self._camera, *arguments)
