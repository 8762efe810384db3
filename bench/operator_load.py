"""What the page's server costs the estimator while many ask it for much.

./omm exec python bench/operator_load.py

One measuring program with the page at rest, then one while another process (at nice 19) asks the
server for pictures and files as fast as it answers, with ten pages looking on. Told: how long the
estimate follows its image (from the middle of the exposure), and how much was asked.
"""

from __future__ import annotations

import argparse
import asyncio
import http.client
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))

_PATHS = ("/picture.jpg", "/", "/file/app.js", "/language/de.json", "/session")
_THREADS, _PAGES = 4, 10


def main() -> None:
    """Measure twice and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flood", type=int, help="used by itself: the port to ask")
    options = parser.parse_args()
    if options.flood:
        asyncio.run(_flood(options.flood))
        return
    from page_bench import cell_with_page

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with (
        tempfile.TemporaryDirectory() as folder,
        cell_with_page(Path(folder), port, tilt_rad=2e-3) as cell,
    ):
        quiet = _run(cell)
        with subprocess.Popen(
            [sys.executable, __file__, "--flood", str(port)], stdout=subprocess.PIPE, text=True
        ) as flood:
            try:
                busy = _run(cell)
            finally:
                flood.terminate()
                asked = flood.communicate()[0]
    for name, delays in (("at rest", quiet), ("under load", busy)):
        print(f"server {name}: the estimate follows its image after {_told(delays)}")
    print(asked.strip())


def _told(delays_s: list[float]) -> str:
    ordered = sorted(1e3 * delay for delay in delays_s)
    return (
        f"{statistics.median(ordered):.0f} ms (p50), {ordered[-1]:.0f} ms (longest of"
        f" {len(ordered)} images)"
    )


def _run(cell: object) -> list[float]:
    """Measure once and return how long each image's first estimate took, s."""
    from omm_interfaces.msg import PartEstimate
    from page_bench import until
    from std_srvs.srv import Trigger

    from omm_ros import qos, topics
    from omm_ros.conversions import stamp_ns

    node = cell._node  # type: ignore[attr-defined]
    clear = node.create_client(Trigger, "estimator/new_clamping")
    start = node.create_client(Trigger, "cnc_bridge/start_program")
    until(lambda: clear.service_is_ready() and start.service_is_ready(), "the nodes")
    time.sleep(5.0)  # kernels are loaded, stations heard
    answer = clear.call_async(Trigger.Request())
    until(answer.done, "a new clamping")
    delays: dict[int, float] = {}

    def hear(message: PartEstimate) -> None:
        for image in message.images:
            stamp = stamp_ns(image.stamp)
            if stamp not in delays:
                delays[stamp] = time.time() - stamp / 1e9

    listening = node.create_subscription(PartEstimate, topics.ESTIMATE, hear, qos.LATCHED)
    answer = start.call_async(Trigger.Request())
    until(answer.done, "the start")
    until(lambda: len(delays) >= 8, "eight images", 240.0)
    node.destroy_subscription(listening)
    return list(delays.values())


async def _flood(port: int) -> None:
    """Ask until terminated, then say how much was answered."""
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    os.nice(19)  # as if it asked from another computer
    host = f"127.0.0.1:{port}"
    connection = http.client.HTTPConnection(host, timeout=30)
    connection.request("GET", "/")
    first = connection.getresponse()
    first.read()
    cookies = "; ".join(c.partition(";")[0] for c in first.msg.get_all("Set-Cookie") or [])
    headers, counts, begin_s = {"Cookie": cookies}, [0] * _THREADS, time.monotonic()
    heard = [0]

    def ask(number: int) -> None:
        mine = http.client.HTTPConnection(host, timeout=30)
        while True:
            mine.request("GET", _PATHS[counts[number] % len(_PATHS)], headers=headers)
            mine.getresponse().read()
            counts[number] += 1

    async def look_on() -> None:
        own = {**headers, "Origin": f"http://{host}"}
        page = await websocket_connect(HTTPRequest(f"ws://{host}/live", headers=own))
        while await page.read_message() is not None:
            heard[0] += 1

    for number in range(_THREADS):
        threading.Thread(target=ask, args=(number,), daemon=True).start()
    looking = [asyncio.ensure_future(look_on()) for _ in range(_PAGES)]
    ended = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    await ended.wait()
    seconds = time.monotonic() - begin_s
    for one in looking:
        one.cancel()
    print(
        f"load: {sum(counts) / seconds:.0f} requests a second were answered, and"
        f" {heard[0] / seconds:.0f} states shown to {_PAGES} pages, for {seconds:.0f} s",
        flush=True,
    )
    os._exit(0)  # the asking threads never end


if __name__ == "__main__":
    main()
