"""A simulated GigE Vision camera that speaks the real protocol, on any address of this computer.

Aravis' own fake camera does the talking; what it shows is ours. It has what a measuring camera has
besides: a clock that can be latched, a black level, lines, a temperature, packed 12-bit pixels.
"""

import ctypes
import os
import tempfile
import threading
import time
from collections.abc import Callable
from ctypes import byref, c_char, c_size_t, c_uint32

import numpy as np
from numpy.typing import NDArray

from omm_camera_driver.drivers.genicam import aravis
from omm_camera_driver.drivers.gige import gvcp
from omm_camera_driver.pixels import MONO8, MONO12_PACKED, MONO16
from omm_core.errors import DeviceError

Fill = Callable[[int, int, int], NDArray[np.generic]]
"""Image (height, width) of uint8 or uint16, from begin (ns), exposure (ns) and bits (8 or 16)."""

# Registers of Aravis' fake camera (arvfakecamera.h), and of the protocol.
_WIDTH, _HEIGHT, _SENSOR_HEIGHT, _SENSOR_WIDTH = 0x100, 0x104, 0x118, 0x11C
_OFFSET_X, _OFFSET_Y, _EXPOSURE_US, _FRAME_PERIOD_US = 0x130, 0x134, 0x120, 0x138
_VENDOR, _MODEL = 0x48, 0x68
_TIMESTAMP_CONTROL, _TIMESTAMP_HIGH, _TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
_TEMPERATURE = 0x0424
_TRIGGER_TICK_HZ = 1000.0  # how often it looks for a software trigger; 25 Hz by default
_CLOCK_TICK_S = 0.002
_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, c_uint32, c_uint32, c_uint32
)  # fmt: skip


def _register_feature(name: str, address: int, low: int, high: int, access: str = "RW") -> str:
    return f"""
    <Integer Name="{name}" NameSpace="Standard"><pValue>{name}Register</pValue>
      <Min>{low}</Min><Max>{high}</Max></Integer>
    <IntReg Name="{name}Register" NameSpace="Custom"><Address>{address:#x}</Address>
      <Length>4</Length><AccessMode>{access}</AccessMode><pPort>Device</pPort>
      <Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"""


def _choice_feature(name: str, address: int, choices: tuple[str, ...]) -> str:
    entries = "".join(
        f'<EnumEntry Name="{choice}" NameSpace="Standard"><Value>{i}</Value></EnumEntry>'
        for i, choice in enumerate(choices)
    )
    return f"""
    <Enumeration Name="{name}" NameSpace="Standard">{entries}
      <pValue>{name}Register</pValue></Enumeration>
    <IntReg Name="{name}Register" NameSpace="Custom"><Address>{address:#x}</Address>
      <Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort>
      <Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"""


_MORE_FEATURES = "".join((
    _register_feature("BlackLevelRaw", 0x0400, 0, 255),
    _choice_feature("LineSelector", 0x0410, ("Line0", "Line1")),
    _choice_feature("LineMode", 0x0414, ("Input", "Output")),
    _choice_feature("LineSource", 0x0418, ("Off", "ExposureActive")),
    _register_feature("DeviceTemperature", _TEMPERATURE, 0, 100, "RO"),
))  # fmt: skip
_PACKED_12 = '<EnumEntry Name="Mono12Packed" NameSpace="Standard"><Value>%d</Value></EnumEntry>'


class GigeSimulator:
    """A camera on an address; it lives until it is closed.

    Parameters
    ----------
    fill : what it sees
    width_px, height_px : of its sensor
    address : of this computer; there can be one camera on each (127.0.0.2, …)
    exposure_us : that it begins with
    """

    def __init__(
        self,
        fill: Fill,
        width_px: int,
        height_px: int,
        *,
        address: str = "127.0.0.1",
        serial: str = "OMM-SIM-1",
        exposure_us: int = 8000,
    ) -> None:
        if gvcp.ask(address) is not None:
            raise DeviceError(
                f"Expected {address} to be free, but a camera is there already. The protocol's "
                "port is fixed: one camera per address (ip addr add 127.0.0.2/8 dev lo)."
            )
        self._fill = fill
        self._arv = arv = aravis.load()
        self.problem = ""
        self._camera = _new_fake_camera(arv, address, serial)
        self._inner = arv.gv_fake_camera_get_fake_camera(self._camera)
        self._name(vendor=b"omm", model=b"simulated GigE camera")
        for register, value in (
            (_SENSOR_WIDTH, width_px), (_SENSOR_HEIGHT, height_px), (_WIDTH, width_px),
            (_HEIGHT, height_px), (_EXPOSURE_US, exposure_us), (_TEMPERATURE, 41),
        ):  # fmt: skip
            arv.fake_camera_write_register(self._inner, register, value)
        arv.fake_camera_set_trigger_frequency(self._inner, _TRIGGER_TICK_HZ)
        self._callback = _FILL(self._on_fill)  # must live as long as the camera
        arv.fake_camera_set_fill_pattern(self._inner, self._callback, None)
        self._closing = threading.Event()
        self._clock = threading.Thread(target=self._keep_clock, name="camera clock", daemon=True)
        self._clock.start()

    def lose_packets(self, ratio: float) -> None:
        """Lose this share of the image packets (Aravis' camera cannot send them again)."""
        self._arv.object_set_double(self._camera, b"gvsp-lost-ratio", ratio)

    def register(self, address: int) -> int:
        """Return the value of a register."""
        value = c_uint32()
        self._arv.fake_camera_read_register(self._inner, address, byref(value))
        return value.value

    def close(self) -> None:
        """Go off the network at once, as if the cable were pulled."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._clock.join()
        self._arv.g_object_unref(self._camera)

    def _name(self, vendor: bytes, model: bytes) -> None:
        for register, text in ((_VENDOR, vendor), (_MODEL, model)):
            self._arv.fake_camera_write_memory(self._inner, register, 32, text.ljust(32, b"\0"))

    def _on_fill(
        self, buffer: int, _data: None, exposure_us: int, _gain: int, pixel_format: int
    ) -> None:
        """Render the image when Aravis begins an exposure; it goes out when this returns."""
        begin_ns = self._arv.buffer_get_timestamp(buffer)
        bits = 8 if pixel_format == MONO8 else 16
        try:
            image = self._fill(begin_ns, exposure_us * 1000, bits)
            self.problem = ""
        except DeviceError as error:
            # The light is out: a camera that sees nothing sends black.
            self.problem = str(error)
            image = np.zeros((self.register(_SENSOR_HEIGHT), self.register(_SENSOR_WIDTH)), "u1")
        x, y = self.register(_OFFSET_X), self.register(_OFFSET_Y)
        width, height = self.register(_WIDTH), self.register(_HEIGHT)
        self._write(buffer, _encoded(image[y : y + height, x : x + width], pixel_format))

    def _write(self, buffer: int, data: bytes | memoryview) -> None:
        """Copy into Aravis' buffer, which is as large as its registers say."""
        count = min(len(data), self._arv.fake_camera_get_payload(self._inner))
        address = self._arv.buffer_get_data(buffer, None)
        target = memoryview((c_char * count).from_address(address)).cast("B")
        target[:] = data[:count]

    def _keep_clock(self) -> None:
        """Latch the clock when asked to; Aravis' camera only stores the command."""
        write = self._arv.fake_camera_write_register
        while not self._closing.wait(_CLOCK_TICK_S):
            if self.register(_TIMESTAMP_CONTROL) & 2:
                now_ns = time.time_ns()
                write(self._inner, _TIMESTAMP_HIGH, now_ns >> 32)
                write(self._inner, _TIMESTAMP_LOW, now_ns & 0xFFFFFFFF)
                write(self._inner, _TIMESTAMP_CONTROL, 0)


def _encoded(image: NDArray[np.generic], pixel_format: int) -> bytes | memoryview:
    if pixel_format == MONO8:
        return np.ascontiguousarray(image, dtype=np.uint8).reshape(-1).data
    wide = np.ascontiguousarray(image, dtype="<u2")
    if pixel_format == MONO16:
        return wide.reshape(-1).view(np.uint8).data
    if pixel_format == MONO12_PACKED:
        pairs = (wide >> 4).reshape(-1, 2)
        packed = np.empty((len(pairs), 3), np.uint8)
        packed[:, 0], packed[:, 2] = pairs[:, 0] >> 4, pairs[:, 1] >> 4
        packed[:, 1] = pairs[:, 0] & 15 | (pairs[:, 1] & 15) << 4
        return packed.reshape(-1).data
    raise DeviceError(f"Expected Mono8, Mono16 or Mono12Packed, got {pixel_format:#x}.")


def _new_fake_camera(arv: aravis.Aravis, address: str, serial: str) -> int:
    """Return Aravis' camera with the features of its own and ours."""
    plain = arv.fake_camera_new(b"plain")
    size = c_size_t()
    xml = ctypes.string_at(arv.fake_camera_get_genicam_xml(plain, byref(size)), size.value)
    arv.g_object_unref(plain)
    text = xml.rstrip(b"\0").decode()
    text = text.replace("<!-- Port -->", f"{_MORE_FEATURES}<!-- Port -->")
    text = text.replace(
        '<EnumEntry Name="Mono16"', f'{_PACKED_12 % MONO12_PACKED}<EnumEntry Name="Mono16"'
    )
    handle, path = tempfile.mkstemp(suffix=".xml")
    try:
        with os.fdopen(handle, "w") as file:
            file.write(text)
        camera = arv.gv_fake_camera_new_full(address.encode(), serial.encode(), path.encode())
    finally:
        os.unlink(path)
    if not camera or not arv.gv_fake_camera_is_running(camera) or gvcp.ask(address, 0.5) is None:
        raise DeviceError(
            f"Expected to put a camera on {address}, but it does not answer there. Is it an "
            "address of this computer (ip addr)?"
        )
    return int(camera)
