"""Which GigE Vision cameras are there: the protocol's discovery, over plain UDP.

A camera answers discovery on any network, whether or not its address suits the computer, and while
another program holds it: that is how a camera that cannot be used is told from one that is absent.
The questions take milliseconds; opening a camera that is absent takes seconds.

GigE Vision 1.0, "GVCP": big-endian, UDP port 3956.
"""

import ipaddress
import select
import socket
import struct
import time
from dataclasses import dataclass

PORT = 3956
_DISCOVERY = struct.pack(">BBHHH", 0x42, 0x11, 0x0002, 0, 1)  # answered by broadcast as well
_READ_REGISTER = 0x0080
_CONTROL_CHANNEL_PRIVILEGE = 0x0A00
_HELD = 0b11  # exclusive access, control access
_QUESTIONS, _BETWEEN_S, _PAUSE_S = 4, 0.5, 3.5
# Bootstrap registers, in the order of the discovery's answer.
_IP, _MASK = 0x24, 0x34
_MANUFACTURER, _MODEL, _SERIAL, _USER_NAME = (0x48, 32), (0x68, 32), (0xD8, 16), (0xE8, 16)


@dataclass(frozen=True, kw_only=True)
class FoundCamera:
    """A camera that answered.

    Attributes
    ----------
    address : str
        As the camera says.
    mask : str
        Of its subnet.
    interface : str
        Address of the computer's interface that it was found on.
    """

    vendor: str
    model: str
    serial: str
    name: str
    address: str
    mask: str
    interface: str

    def is_called(self, name: str) -> bool:
        """Return whether the user asked for this: serial number, address, model or own name."""
        return name in (self.serial, self.address, self.model, self.name)

    def why_unreachable(self) -> str:
        """Return why its address cannot be used from here; empty if it can."""
        if ask(self.address) is not None:
            return ""
        return (
            f"it is heard on {self.interface}, but does not answer at its own address "
            f"{self.address} (mask {self.mask}). Give the camera an address in the network of "
            "that interface, or the interface one in the camera's"
        )


def ask(address: str, timeout_s: float = 0.15) -> FoundCamera | None:
    """Return the camera at an address, or None when none answers."""
    with _socket("") as sock:
        try:
            sock.sendto(_DISCOVERY, (address, PORT))
        except OSError:
            return None
        answers = _answers([(sock, "")], timeout_s, enough=1)
    return answers[0] if answers else None


def discover(timeout_s: float = 0.4) -> list[FoundCamera]:
    """Return all cameras that can be heard, on every interface.

    The loopback interface has no broadcast, so its first address is asked directly.
    """
    sockets: list[tuple[socket.socket, str]] = []
    try:
        for interface in _interfaces():
            sock = _socket(interface)
            sockets.append((sock, interface))
            loopback = ipaddress.ip_address(interface).is_loopback
            for target in (interface,) if loopback else ("255.255.255.255",):
                try:
                    sock.sendto(_DISCOVERY, (target, PORT))
                except OSError:  # an interface that is down or does not allow it
                    continue
        found = _answers(sockets, timeout_s)
    finally:
        for sock, _ in sockets:
            sock.close()
    return list({(c.serial, c.address): c for c in found}.values())


def is_held(address: str, timeout_s: float = 0.3) -> bool | None:
    """Return whether another program controls the camera; None when it does not say."""
    with _socket("") as sock:
        request = struct.pack(
            ">BBHHHI", 0x42, 0x01, _READ_REGISTER, 4, 2, _CONTROL_CHANNEL_PRIVILEGE
        )
        try:
            sock.sendto(request, (address, PORT))
        except OSError:
            return None
        if not select.select([sock], [], [], timeout_s)[0]:
            return None
        data = sock.recv(600)
    if len(data) < 12:
        return None
    return bool(struct.unpack(">I", data[8:12])[0] & _HELD)


class HeldWatch:
    """Asks whether a camera is held, without keeping it held.

    Some cameras (Aravis' own among them) take any reading of that register as a sign of life of the
    program that holds it. One that crashed would be kept alive by being asked about, so after a few
    questions there is a pause as long as a holder may be silent.
    """

    def __init__(self) -> None:
        self._answered_held_s: list[float] = []

    def is_held(self, address: str) -> bool:
        """Return whether another program controls the camera, as far as may be asked now."""
        now_s = time.monotonic()
        asked = self._answered_held_s
        if asked and now_s - asked[-1] < (_PAUSE_S if len(asked) >= _QUESTIONS else _BETWEEN_S):
            return True
        if is_held(address):
            self._answered_held_s = [*asked[-_QUESTIONS + 1 :], time.monotonic()]
            if asked and now_s - asked[-1] > _PAUSE_S:
                self._answered_held_s = [time.monotonic()]
            return True
        asked.clear()
        return False


def _socket(interface: str) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    sock.bind((interface, 0))
    return sock


def _answers(
    sockets: list[tuple[socket.socket, str]], timeout_s: float, enough: int = 1000
) -> list[FoundCamera]:
    found: list[FoundCamera] = []
    end_s = time.monotonic() + timeout_s
    interfaces = dict(sockets)
    while len(found) < enough and (left_s := end_s - time.monotonic()) > 0.0:
        for sock in select.select(list(interfaces), [], [], left_s)[0]:
            try:
                data = sock.recv(600)
            except OSError:  # "connection refused" by a computer without a camera
                continue
            camera = _parse(data, interfaces[sock])
            if camera is not None:
                found.append(camera)
    return found


def _parse(data: bytes, interface: str) -> FoundCamera | None:
    if len(data) < 8 + 0xF8 or data[2:4] != b"\x00\x03":
        return None
    registers = data[8:]

    def text(where: tuple[int, int]) -> str:
        offset, length = where
        return registers[offset : offset + length].split(b"\0")[0].decode("utf-8", "replace")

    return FoundCamera(
        vendor=text(_MANUFACTURER),
        model=text(_MODEL),
        serial=text(_SERIAL),
        name=text(_USER_NAME),
        address=socket.inet_ntoa(registers[_IP : _IP + 4]),
        mask=socket.inet_ntoa(registers[_MASK : _MASK + 4]),
        interface=interface,
    )


def _interfaces() -> list[str]:
    """Return the computer's own IPv4 addresses (Linux)."""
    import fcntl

    addresses = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(sock.fileno(), 0x8915, request)  # SIOCGIFADDR
            except OSError:  # no address
                continue
            addresses.append(socket.inet_ntoa(answer[20:24]))
    return addresses
