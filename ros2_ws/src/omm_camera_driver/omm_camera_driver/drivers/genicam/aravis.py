"""The part of libaravis-0.8 that omm uses, through ctypes.

PyGObject would copy every image on its way to numpy; through ctypes a frame lands in a buffer of
ours. Every call that can fail raises DeviceError with Aravis' own text.
"""

import ctypes
import ctypes.util
from ctypes import POINTER, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint32, c_uint64
from ctypes import c_void_p as pointer
from functools import lru_cache
from typing import Any

from omm_core.errors import DeviceError

LIBRARY = "libaravis-0.8.so.0"
PACKAGE = "libaravis-0.8-0"

BUFFER_SUCCESS = 0
SOCKET_BUFFER_FIXED = 0
USB_MODES = {"sync": 0, "async": 1}
RESEND_NEVER, RESEND_ALWAYS = 0, 1
AUTO_OFF = 0
RANGE_CHECK_ENABLE = 1


class AravisMissing(DeviceError):
    """The library is not installed."""


class _GError(ctypes.Structure):
    _fields_ = [("domain", c_uint32), ("code", c_int), ("message", c_char_p)]


# name: (result, arguments without the trailing GError **); these report errors.
_FALLIBLE: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_camera_new": (pointer, (c_char_p,)),
    "arv_camera_new_with_device": (pointer, (pointer,)),
    "arv_interface_open_device": (pointer, (pointer, c_char_p)),
    "arv_camera_create_stream": (pointer, (pointer, pointer, pointer)),
    "arv_camera_get_vendor_name": (c_char_p, (pointer,)),
    "arv_camera_get_model_name": (c_char_p, (pointer,)),
    "arv_camera_get_device_serial_number": (c_char_p, (pointer,)),
    "arv_camera_get_payload": (c_uint32, (pointer,)),
    "arv_camera_set_region": (None, (pointer, c_int, c_int, c_int, c_int)),
    "arv_camera_get_region": (None, (pointer, *(POINTER(c_int),) * 4)),
    "arv_camera_get_width_bounds": (None, (pointer, *(POINTER(c_int),) * 2)),
    "arv_camera_get_height_bounds": (None, (pointer, *(POINTER(c_int),) * 2)),
    "arv_camera_set_pixel_format_from_string": (None, (pointer, c_char_p)),
    "arv_camera_get_pixel_format_as_string": (c_char_p, (pointer,)),
    "arv_camera_dup_available_pixel_formats": (POINTER(c_int64), (pointer, POINTER(c_uint32))),
    "arv_camera_dup_available_pixel_formats_as_strings": (
        POINTER(c_char_p),
        (pointer, POINTER(c_uint32)),
    ),
    "arv_camera_start_acquisition": (None, (pointer,)),
    "arv_camera_stop_acquisition": (None, (pointer,)),
    "arv_camera_set_acquisition_mode": (None, (pointer, c_int)),
    "arv_camera_set_trigger": (None, (pointer, c_char_p)),
    "arv_camera_clear_triggers": (None, (pointer,)),
    "arv_camera_is_software_trigger_supported": (c_int, (pointer,)),
    "arv_camera_software_trigger": (None, (pointer,)),
    "arv_camera_gv_set_packet_size": (None, (pointer, c_int)),
    "arv_camera_gv_auto_packet_size": (c_uint32, (pointer,)),
    "arv_camera_gv_get_packet_size": (c_uint32, (pointer,)),
    "arv_camera_is_feature_available": (c_int, (pointer, c_char_p)),
    "arv_camera_set_string": (None, (pointer, c_char_p, c_char_p)),
    "arv_camera_get_string": (c_char_p, (pointer, c_char_p)),
    "arv_camera_set_boolean": (None, (pointer, c_char_p, c_int)),
    "arv_camera_get_float": (c_double, (pointer, c_char_p)),
    "arv_camera_set_float": (None, (pointer, c_char_p, c_double)),
    "arv_camera_get_integer": (c_int64, (pointer, c_char_p)),
    "arv_camera_get_integer_bounds": (None, (pointer, c_char_p, *(POINTER(c_int64),) * 2)),
    "arv_camera_set_integer": (None, (pointer, c_char_p, c_int64)),
    "arv_camera_get_boolean": (c_int, (pointer, c_char_p)),
    "arv_camera_get_pixel_format": (c_uint32, (pointer,)),
    "arv_camera_execute_command": (None, (pointer, c_char_p)),
    "arv_device_read_register": (c_int, (pointer, c_uint64, POINTER(c_uint32))),
    "arv_device_write_register": (c_int, (pointer, c_uint64, c_uint32)),
    "arv_device_set_features_from_string": (c_int, (pointer, c_char_p)),
    **{
        f"arv_camera_is_{name}_available": (c_int, (pointer,))
        for name in ("exposure_time", "gain", "black_level", "frame_rate",
                     "exposure_auto", "gain_auto", "black_level_auto")
    },
    **{
        f"arv_camera_set_{name}_auto": (None, (pointer, c_int))
        for name in ("exposure_time", "gain", "black_level")
    },
    **{
        f"arv_camera_set_{name}": (None, (pointer, c_double))
        for name in ("exposure_time", "gain", "black_level", "frame_rate")
    },
    **{
        f"arv_camera_get_{name}": (c_double, (pointer,))
        for name in ("exposure_time", "gain", "black_level", "frame_rate")
    },
    **{
        f"arv_camera_get_{name}_bounds": (None, (pointer, POINTER(c_double), POINTER(c_double)))
        for name in ("exposure_time", "gain", "black_level", "frame_rate")
    },
}  # fmt: skip

_PLAIN: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_camera_get_device": (pointer, (pointer,)),
    "arv_uv_interface_get_instance": (pointer, ()),
    "arv_fake_interface_get_instance": (pointer, ()),
    "arv_interface_update_device_list": (None, (pointer,)),
    "arv_interface_get_n_devices": (c_uint32, (pointer,)),
    **{
        f"arv_interface_get_device_{name}": (c_char_p, (pointer, c_uint32))
        for name in ("id", "physical_id", "vendor", "model", "serial_nbr")
    },
    "arv_camera_is_gv_device": (c_int, (pointer,)),
    "arv_camera_gv_set_stream_options": (None, (pointer, c_int)),
    "arv_camera_is_uv_device": (c_int, (pointer,)),
    "arv_camera_uv_set_usb_mode": (None, (pointer, c_int)),
    "arv_device_set_range_check_policy": (None, (pointer, c_int)),
    "arv_gv_device_is_controller": (c_int, (pointer,)),
    "arv_stream_push_buffer": (None, (pointer, pointer)),
    "arv_stream_timeout_pop_buffer": (pointer, (pointer, c_uint64)),
    "arv_stream_try_pop_buffer": (pointer, (pointer,)),
    "arv_stream_get_statistics": (None, (pointer, *(POINTER(c_uint64),) * 3)),
    "arv_gv_stream_get_statistics": (None, (pointer, *(POINTER(c_uint64),) * 2)),
    "arv_buffer_new": (pointer, (c_size_t, pointer)),
    "arv_buffer_get_status": (c_int, (pointer,)),
    "arv_buffer_get_timestamp": (c_uint64, (pointer,)),
    "arv_buffer_get_system_timestamp": (c_uint64, (pointer,)),
    "arv_buffer_get_frame_id": (c_uint64, (pointer,)),
    "arv_buffer_get_image_width": (c_int, (pointer,)),
    "arv_buffer_get_image_height": (c_int, (pointer,)),
    "arv_buffer_get_image_pixel_format": (c_uint32, (pointer,)),
    "arv_buffer_get_image_padding": (None, (pointer, *(POINTER(c_int),) * 2)),
    "arv_buffer_get_data": (pointer, (pointer, POINTER(c_size_t))),
    "arv_gv_fake_camera_new_full": (pointer, (c_char_p, c_char_p, c_char_p)),
    "arv_gv_fake_camera_get_fake_camera": (pointer, (pointer,)),
    "arv_gv_fake_camera_is_running": (c_int, (pointer,)),
    "arv_fake_camera_new": (pointer, (c_char_p,)),
    "arv_fake_camera_get_genicam_xml": (pointer, (pointer, POINTER(c_size_t))),
    "arv_fake_camera_get_payload": (c_size_t, (pointer,)),
    "arv_fake_camera_write_register": (c_int, (pointer, c_uint32, c_uint32)),
    "arv_fake_camera_read_register": (c_int, (pointer, c_uint32, POINTER(c_uint32))),
    "arv_fake_camera_write_memory": (c_int, (pointer, c_uint32, c_uint32, c_char_p)),
    "arv_fake_camera_set_trigger_frequency": (None, (pointer, c_double)),
    "arv_fake_camera_set_fill_pattern": (None, (pointer, pointer, pointer)),
    "arv_fake_device_get_fake_camera": (pointer, (pointer,)),
    "arv_set_fake_camera_genicam_filename": (None, (c_char_p,)),
}

# A library that was built without USB is as good for the others.
_MAY_LACK = frozenset({"arv_uv_interface_get_instance"})


class Aravis:
    """The library: `aravis.camera_new(b"…")` calls `arv_camera_new`."""

    def __init__(self, library: ctypes.CDLL, glib: ctypes.CDLL) -> None:
        self._library = library
        for name, (result, arguments) in _FALLIBLE.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, (*arguments, POINTER(POINTER(_GError)))
            setattr(self, name.removeprefix("arv_"), self._raising(function))
        for name, (result, arguments) in _PLAIN.items():
            if name in _MAY_LACK and not hasattr(library, name):
                continue
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
            setattr(self, name.removeprefix("arv_"), function)
        self._free_error = glib.g_error_free
        self._free_error.restype, self._free_error.argtypes = None, (pointer,)
        self.g_object_unref = glib.g_object_unref
        self.g_object_unref.restype, self.g_object_unref.argtypes = None, (pointer,)
        self.g_free = glib.g_free
        self.g_free.restype, self.g_free.argtypes = None, (pointer,)
        self._g_object_set = glib.g_object_set

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"arv_{name} is not declared in {__name__}.")

    def object_set(self, instance: int, name: bytes, value: int) -> None:
        """Set an integer or enumeration property of a GObject."""
        self._g_object_set(pointer(instance), c_char_p(name), c_int(value), pointer(None))

    def object_set_double(self, instance: int, name: bytes, value: float) -> None:
        """Set a floating-point property of a GObject."""
        self._g_object_set(pointer(instance), c_char_p(name), c_double(value), pointer(None))

    def _raising(self, function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            error = POINTER(_GError)()
            result = function(*arguments, ctypes.byref(error))
            if error:
                text = (error.contents.message or b"").decode("utf-8", "replace")
                self._free_error(ctypes.cast(error, pointer))
                raise DeviceError(text)
            return result

        return call


@lru_cache(maxsize=1)
def load() -> Aravis:
    """Load the library.

    Raises
    ------
    AravisMissing
        It is not installed, or too old.
    """
    try:
        # The library brings GLib's symbols along: its dependencies are searched through it.
        library = ctypes.CDLL(LIBRARY)
        return Aravis(library, library)
    except (OSError, AttributeError) as error:
        raise AravisMissing(
            f"Expected the library {LIBRARY} for GigE and USB3 Vision cameras ({error}). "
            f"On Debian and Ubuntu: sudo apt install {PACKAGE}"
        ) from error
