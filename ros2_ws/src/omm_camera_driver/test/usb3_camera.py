"""A USB3 Vision camera that plugs itself into this very kernel (root, gadgetfs and dummy_hcd).

The kernel's dummy controller is host and device at once: what is written here to gadgetfs goes
through the kernel's whole USB stack, libusb and Aravis, as from a camera on a cable (at the speed
of USB 2). USB3 Vision 1.0: GenCP over one pair of bulk endpoints, images over another; all
little-endian. What the camera can is described by Aravis' own GenICam file, whose registers are
moved out of the way.
"""

import ctypes
import multiprocessing
import os
import re
import struct
import subprocess
import threading
import time
from ctypes import byref, c_size_t
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from queue import Queue

import numpy as np
from numpy.typing import NDArray

from omm_camera_driver.drivers.genicam import aravis

VENDOR, MODEL, GUID, SERIAL = "omm", "M-500", "0ABC12345678", "22097655"
WIDTH, HEIGHT = 512, 384
TICK_NS = 8  # so finely goes its clock, which began an hour before

_FOLDER = Path("/dev/gadget")
_STRINGS = {1: VENDOR, 2: MODEL, 3: GUID, 4: SERIAL, 5: "family", 6: "1.0", 7: "info", 8: "name"}
_SETUP = 3
_GET_DESCRIPTOR, _SET_CONFIGURATION, _STRING = 0x06, 0x09, 0x03

_MEMORY, _SBRM, _SIRM, _MANIFEST, _FEATURES, _XML = (
    0x40000,
    0x2000,
    0x3000,
    0x4000,
    0x10000,
    0x20000,
)
_TIMESTAMP, _TIMESTAMP_LATCH, _TIMESTAMP_INCREMENT = 0x1F0, 0x1F8, 0x1FC
_WIDTH, _HEIGHT, _EXPOSURE_US = _FEATURES + 0x100, _FEATURES + 0x104, _FEATURES + 0x120
_PIXEL_FORMAT, _TRIGGER_SOFTWARE = _FEATURES + 0x128, _FEATURES + 0x30C
_COMMAND, _LEADER, _TRAILER = 0x43563355, 0x4C563355, 0x54563355
_READ, _READ_ACK, _WRITE, _WRITE_ACK = 0x0800, 0x0801, 0x0802, 0x0803
_LEADER_BYTES, _TRAILER_BYTES = 52, 28


class Usb3Camera:
    """A camera that is plugged in until it is unplugged; a process of its own.

    The kernel lets a device of gadgetfs go when nobody has it open any more, and a thread that
    waits for the host has it open: a process can be killed whatever it waits for.
    """

    def __init__(self) -> None:
        forking = multiprocessing.get_context("fork")
        self._begins = forking.SimpleQueue()
        self._process = forking.Process(target=_Device(_memory(), self._begins).run, daemon=True)
        self._process.start()

    def begin_ns(self) -> int:
        """Return the system time at which the next of its images was begun."""
        return int(self._begins.get())

    def unplug(self) -> None:
        """Be gone at once, as if the cable were pulled."""
        self._process.kill()
        self._process.join()


def image(number: int, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    """Return what the camera sends as its image of that number, from 0."""
    return np.random.default_rng(number).integers(0, 256, (height, width), np.uint8)


class _Device:
    """The camera's side, in its process."""

    def __init__(self, memory: bytearray, begins: "SimpleQueue[int]") -> None:
        self._memory = memory
        self._begins = begins
        self._booted_ns = time.monotonic_ns() - 3600 * 10**9
        self._triggers: Queue[None] = Queue()
        self._endpoints: list[int] = []

    def run(self) -> None:
        """Plug in, and answer the host for ever."""
        if not _FOLDER.is_mount():
            _FOLDER.mkdir(exist_ok=True)
            subprocess.run(["mount", "-t", "gadgetfs", "gadgetfs", str(_FOLDER)], check=True)
        (controller,) = (f for f in _FOLDER.iterdir() if not f.name.startswith("ep"))
        self._control = os.open(controller, os.O_RDWR)
        described = _configuration(64) + _configuration(512) + _DEVICE
        os.write(self._control, struct.pack("<I", 0) + described)
        self._listen()

    def _listen(self) -> None:
        """Answer what the kernel does not answer itself: strings, and the configuration."""
        while True:
            event = os.read(self._control, 12)
            (kind,) = struct.unpack("<I", event[8:12])
            if kind != _SETUP:
                continue
            _, request, value, _, length = struct.unpack("<BBHHH", event[:8])
            if request == _SET_CONFIGURATION:
                self._configure()
                os.read(self._control, 0)
            elif request == _GET_DESCRIPTOR and value >> 8 == _STRING:
                os.write(self._control, _string(value & 0xFF)[:length])
            else:
                os.read(self._control, 0)  # done; the wrong way round (refused) where it asks

    def _configure(self) -> None:
        if self._endpoints:
            return
        for name, address in (("ep1out-bulk", 0x01), ("ep1in-bulk", 0x81), ("ep2in-bulk", 0x82)):
            endpoint = os.open(_FOLDER / name, os.O_RDWR)
            described = _endpoint(address, 64) + _endpoint(address, 512)
            os.write(endpoint, struct.pack("<I", 1) + described)
            self._endpoints.append(endpoint)
        commands, answers, images = self._endpoints
        threading.Thread(target=self._serve, args=(commands, answers), daemon=True).start()
        threading.Thread(target=self._stream, args=(images,), daemon=True).start()

    def _serve(self, commands: int, answers: int) -> None:
        while True:
            packet = os.read(commands, 65536)
            magic, _, command, _, number = struct.unpack_from("<IHHHH", packet)
            assert magic == _COMMAND
            (address,) = struct.unpack_from("<Q", packet, 12)
            if command == _READ:
                (count,) = struct.unpack_from("<H", packet, 22)
                kind, data = _READ_ACK, bytes(self._memory[address : address + count])
            else:
                kind, data = _WRITE_ACK, struct.pack("<HH", 0, len(packet) - 20)
                self._write(address, packet[20:])
            os.write(answers, struct.pack("<IHHHH", _COMMAND, 0, kind, len(data), number) + data)

    def _write(self, address: int, data: bytes) -> None:
        self._memory[address : address + len(data)] = data
        if address == _TIMESTAMP_LATCH:
            struct.pack_into("<Q", self._memory, _TIMESTAMP, self._uptime_ns() // TICK_NS * TICK_NS)
        elif address == _TRIGGER_SOFTWARE:
            self._triggers.put(None)
        payload_bytes = self._feature(_WIDTH) * self._feature(_HEIGHT)
        struct.pack_into("<Q", self._memory, _SIRM + 0x08, payload_bytes)

    def _stream(self, endpoint: int) -> None:
        number = 0
        while True:
            self._triggers.get()
            uptime_ns, begin_ns = self._uptime_ns(), time.time_ns()
            time.sleep(self._feature(_EXPOSURE_US) / 1e6)
            width, height = self._feature(_WIDTH), self._feature(_HEIGHT)
            pixels = image(number, width, height).tobytes()
            self._begins.put(begin_ns)
            leader = (_LEADER, 0, _LEADER_BYTES, number, 0, 1, uptime_ns)
            region = (self._feature(_PIXEL_FORMAT), width, height, 0, 0, 0, 0)
            os.write(endpoint, struct.pack("<IHHQHHQIIIIIHH", *leader, *region))
            os.write(endpoint, pixels)
            trailer = (_TRAILER, 0, _TRAILER_BYTES, number, 0, len(pixels))
            os.write(endpoint, struct.pack("<IHHQIQ", *trailer))
            number += 1

    def _uptime_ns(self) -> int:
        return time.monotonic_ns() - self._booted_ns

    def _feature(self, address: int) -> int:
        return int(struct.unpack_from(">I", self._memory, address)[0])


def _memory() -> bytearray:
    """Return the camera's memory: bootstrap registers, features as Aravis' camera has them, XML."""
    arv, memory = aravis.load(), bytearray(_MEMORY)
    plain, size = arv.fake_camera_new(b"plain"), c_size_t()
    text = ctypes.string_at(
        arv.fake_camera_get_genicam_xml(plain, byref(size)), size.value
    ).decode()
    read = ctypes.CDLL(aravis.LIBRARY).arv_fake_camera_read_memory
    read.argtypes = (ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_void_p)
    features = ctypes.create_string_buffer(0x1000)
    read(plain, 0, len(features), features)
    arv.g_object_unref(plain)
    memory[_FEATURES : _FEATURES + len(features)] = features.raw
    for address, value in ((_WIDTH, WIDTH), (_HEIGHT, HEIGHT)):
        struct.pack_into(">I", memory, address, value)
    xml = re.sub(
        r"<Address>(\w+)</Address>",
        lambda found: f"<Address>{int(found[1], 16) + _FEATURES:#x}</Address>",
        text.rstrip("\0"),
    ).encode()
    memory[_XML : _XML + len(xml)] = xml
    for address, words in ((0x04, VENDOR), (0x44, MODEL), (0x144, SERIAL)):
        memory[address : address + len(words)] = words.encode()
    for address, form, value in (
        (0x00, "<I", 0x10000), (0x1CC, "<I", 1000), (0x1D0, "<Q", _MANIFEST), (0x1D8, "<Q", _SBRM),
        (_TIMESTAMP_INCREMENT, "<Q", TICK_NS),
        (_SBRM, "<I", 0x10000), (_SBRM + 0x04, "<Q", 1), (_SBRM + 0x14, "<I", 1024),
        (_SBRM + 0x18, "<I", 16384), (_SBRM + 0x1C, "<I", 1), (_SBRM + 0x20, "<Q", _SIRM),
        (_SBRM + 0x28, "<I", 0x30),
        (_SIRM + 0x08, "<Q", WIDTH * HEIGHT), (_SIRM + 0x10, "<I", _LEADER_BYTES),
        (_SIRM + 0x14, "<I", _TRAILER_BYTES),
        (_MANIFEST, "<Q", 1), (_MANIFEST + 8, "<I", 0x01000000), (_MANIFEST + 16, "<Q", _XML),
        (_MANIFEST + 24, "<Q", len(xml)),
    ):  # fmt: skip
        struct.pack_into(form, memory, address, value)
    return memory


_DEVICE = struct.pack(
    "<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0xEF, 0x02, 0x01, 64, 0x1D6B, 0x0104, 0x0100, 1, 2, 3, 1
)


def _endpoint(address: int, packet_bytes: int) -> bytes:
    return struct.pack("<BBBBHB", 7, 5, address, 2, packet_bytes, 0)


def _configuration(packet_bytes: int) -> bytes:
    """Two interfaces of one function: control, with USB3 Vision's descriptor, and streaming."""
    vision = struct.pack("<BBBII9B", 20, 0x24, 1, 0x10000, 0x10000, 3, 1, 2, 5, 6, 7, 4, 8, 0x0F)
    body = (
        struct.pack("<8B", 8, 0x0B, 0, 2, 0xEF, 0x05, 0x00, 0)
        + struct.pack("<9B", 9, 4, 0, 0, 2, 0xEF, 0x05, 0x00, 0)
        + vision
        + _endpoint(0x01, packet_bytes)
        + _endpoint(0x81, packet_bytes)
        + struct.pack("<9B", 9, 4, 1, 0, 1, 0xEF, 0x05, 0x02, 0)
        + _endpoint(0x82, packet_bytes)
    )
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 2, 1, 0, 0x80, 250) + body


def _string(index: int) -> bytes:
    if index == 0:
        return struct.pack("<BBH", 4, _STRING, 0x0409)
    text = _STRINGS[index].encode("utf-16-le")
    return struct.pack("<BB", 2 + len(text), _STRING) + text
