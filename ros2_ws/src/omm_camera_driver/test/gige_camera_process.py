"""A simulated GigE camera as a process of its own, to be killed, stopped and started by tests.

What it shows can be computed by the test: a pattern of the begin of the exposure.
"""

import sys
import time

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 640, 480


def pattern(begin_ns: int, bits: int = 8) -> NDArray[np.generic]:
    """Noise that depends on the begin of the exposure (µs); the first eight pixels are that."""
    tick = begin_ns // 1000
    counter = np.arange(WIDTH * HEIGHT, dtype=np.uint64) + np.uint64(tick)
    noise = (counter * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(64 - bits)
    image = noise.astype(np.uint8 if bits == 8 else np.uint16)
    image[:8] = np.frombuffer(tick.to_bytes(8, "little"), np.uint8)
    return image.reshape(HEIGHT, WIDTH)


def begin_of(image: NDArray[np.generic]) -> int:
    """The begin of the exposure of an image (ns)."""
    return int.from_bytes(image.reshape(-1)[:8].astype(np.uint8).tobytes(), "little") * 1000


def main() -> None:
    """Serve until killed."""
    from omm_camera_driver.drivers.gige.simulator import GigeSimulator

    address, lost = sys.argv[1], float(sys.argv[2])
    simulator = GigeSimulator(
        lambda begin_ns, exposure_ns, bits: pattern(begin_ns, bits), WIDTH, HEIGHT, address=address
    )
    simulator.lose_packets(lost)
    print("ready", flush=True)
    while True:
        time.sleep(3600)


if __name__ == "__main__":
    main()
