"""The operator's page against real nodes: latency, size, load; and the pictures of the docs.

./omm exec python bench/operator_page.py [--pictures docs/pictures]

Latency: from when a change of the program's state is heard over DDS (by a node of this program, as
the page's node hears it) to when the browser has changed the page. Load: processor time of the
page's node, alone at rest, and with one page open while a part is measured.
"""

import argparse
import os
import socket
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))

from omm_interfaces.msg import OperatorCommand, SpindleState
from page_bench import CHROMIUM, CellWithPage, cell_with_page, until
from playwright import sync_api as playwright

from omm_operator.web.handlers import FILES
from omm_ros import qos, topics

WATCH = """
window.seen = [];
new MutationObserver(() => {
  const words = document.querySelector('#program')?.innerText.split(' · ')[0];
  const last = window.seen.at(-1);
  if (words && (!last || last[0] !== words)) {
    window.seen.push([words, performance.timeOrigin + performance.now()]);
  }
}).observe(document, { subtree: true, childList: true, characterData: true });
"""
WORDS = {1: "program stopped", 2: "program running", 3: "program waits for an image",
         4: "program interrupted", 5: "program finished"}  # fmt: skip
REST_S = 10.0


def main() -> None:
    """Measure, print, and take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with (
        tempfile.TemporaryDirectory() as folder,
        cell_with_page(Path(folder), port, tilt_rad=2e-3) as cell,
        playwright.sync_playwright() as started,
    ):
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        _run(cell, browser, options.pictures)
        browser.close()
    size = sum(path.stat().st_size for path in FILES.values())
    print(f"page: {size / 1000:.0f} kB in {len(FILES)} files, without compression")


def _run(cell: CellWithPage, browser: Any, pictures: Path | None) -> None:
    heard: list[tuple[str, float]] = []

    def hear(state: SpindleState) -> None:
        words = WORDS.get(state.program_state, "")
        if not heard or heard[-1][0] != words:
            heard.append((words, time.time() * 1e3))

    cell._node.create_subscription(SpindleState, topics.SPINDLE_STATE, hear, qos.STATE)
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.add_init_script(WATCH)

    def opened() -> bool:
        try:
            page.goto(f"http://127.0.0.1:{cell.port}/")
        except playwright.Error:
            time.sleep(0.3)
            return False
        return True

    until(opened, "the page")
    _ready(page)
    page.goto("about:blank")
    print(f"load at rest, no page open: {_load(cell, REST_S):.1f} % of one processor")
    until(opened, "the page")
    _ready(page)
    print(f"load at rest, one page open: {_load(cell, REST_S):.1f} %")
    _take(page, pictures, "measure_before")
    begin_s, begin = time.monotonic(), _cpu_s(cell)
    _measure(cell, page, pictures)
    busy = 100.0 * (_cpu_s(cell) - begin) / (time.monotonic() - begin_s)
    print(f"load while measuring, one page open: {busy:.1f} %")
    _tell_latency(heard, page.evaluate("() => window.seen"))
    page.reload()
    page.wait_for_selector("#do-start_program")
    time.sleep(0.5)
    paint = page.evaluate(
        "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
    )
    print(f"first paint after a reload: {paint:.0f} ms")
    if pictures is not None:
        _pictures(cell, page, pictures)


def _ready(page: Any) -> None:
    page.wait_for_selector("#do-start_program")
    until(lambda: page.get_attribute("#do-start_program", "aria-disabled") == "false", "stations")


def _measure(cell: CellWithPage, page: Any, pictures: Path | None) -> None:
    page.click("#step-measure")
    box = page.locator("#do-start_program").bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    time.sleep(1.2)
    page.mouse.up()
    until(lambda: "running" in page.inner_text("#program"), "the start")
    until(lambda: "Stop 5" in page.inner_text("#stop"), "the fifth stop")
    _take(page, pictures, "measure")
    until(lambda: "finished" in page.inner_text("#program"), "the end")
    time.sleep(1.0)


def _tell_latency(heard: list[tuple[str, float]], seen: list[tuple[str, float]]) -> None:
    """Pair changes in their order: of each word, the n-th heard with the n-th seen after it."""
    delays = []
    for words, at_ms in heard:
        later = [when for shown, when in seen if shown == words and -50.0 <= when - at_ms <= 3000.0]
        if later:
            delays.append(min(later) - at_ms)
    delays.sort()
    p95 = delays[min(len(delays) - 1, round(0.95 * len(delays)))]
    print(
        f"event to screen: p50 {statistics.median(delays):.0f} ms, p95 {p95:.0f} ms,"
        f" {len(delays)} of {len(heard)} changes"
    )


def _pictures(cell: CellWithPage, page: Any, pictures: Path) -> None:
    for step in ("result", "correct", "hand"):
        page.click(f"#step-{step}")
        time.sleep(0.7)
        _take(page, pictures, step)
    page.click("#step-correct")
    page.click("#do-corrected")
    until(lambda: cell.given("corrected", OperatorCommand.ACCEPTED), "the correction")
    _ready_again(page)
    _measure(cell, page, None)
    page.click("#step-correct")
    time.sleep(0.7)
    _take(page, pictures, "correct_after")
    page.click("#step-hand")
    until(lambda: page.get_attribute("#do-hand_over", "aria-disabled") == "false", "conditions")
    box = page.locator("#do-hand_over").bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    time.sleep(1.3)
    page.mouse.up()
    until(lambda: "is equal" in page.inner_text("#handed"), "the read-back")
    _take(page, pictures, "hand_over")
    page.set_viewport_size({"width": 800, "height": 480})
    page.select_option("#language", "de")
    page.click("#step-result")
    time.sleep(0.7)
    _take(page, pictures, "result_small_german")


def _ready_again(page: Any) -> None:
    page.click("#step-measure")
    _ready(page)


def _take(page: Any, pictures: Path | None, name: str) -> None:
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=str(pictures / f"{name}.png"))


def _cpu_s(cell: CellWithPage) -> float:
    with open(f"/proc/{cell.processes['operator'].pid}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _load(cell: CellWithPage, seconds: float) -> float:
    before = _cpu_s(cell)
    time.sleep(seconds)
    return 100.0 * (_cpu_s(cell) - before) / seconds


if __name__ == "__main__":
    main()
