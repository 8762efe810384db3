"""The operator's page as a person uses it: a real browser against the real nodes.

One cell and one open page serve all tests, so each leaves a page that is well behind, and takes
what it needs (`Screen.measured`). They are in the order that takes the fewest measurements.
"""

import http.server
import re
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from axe_playwright_python.sync_playwright import Axe
from mcap.reader import make_reader
from omm_interfaces.msg import OperatorCommand
from page_bench import CHROMIUM, CellWithPage, cell_with_page, until
from playwright import sync_api as playwright

from omm_operator.screen.desk import TWIN_S

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed (apt-get install chromium)"
)
STEPS = ("measure", "result", "correct", "hand")
SIZES = ((800, 480), (1280, 800), (1920, 1080))
SIZE = {"width": 1280, "height": 800}
TARGET_PX, MAIN_PX = 57, 76
STRANGER = "stranger.example"
TILT_RAD, TOLERANCE_RAD = 5e-3, 5e-5
FASTER = 5.0  # than the scenario's machine moves


class Screen:
    """A page in a browser of its own; whatever it asks of others than the node fails the test."""

    def __init__(self, browser: Any, port: int) -> None:
        self.foreign: list[str] = []
        self.errors: list[str] = []
        self._tapped_s: dict[str, float] = {}
        self._own = f"http://127.0.0.1:{port}/"
        self.context = browser.new_context(viewport=SIZE)
        self.context.route("**/*", self._route)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        until(self._opened, "the page")
        self.page.wait_for_selector("#do-start_program")

    def _opened(self) -> bool:
        try:
            self.page.goto(self._own)
        except playwright.Error:
            time.sleep(0.3)
            return False
        return True

    def _route(self, route: Any) -> None:
        if route.request.url.startswith(self._own):
            route.continue_()
        else:
            self.foreign.append(route.request.url)
            route.abort()

    def go(self, step: str) -> None:
        self.page.click(f"#step-{step}")
        self.page.wait_for_selector(f"main#{step}")

    def text(self, selector: str) -> str:
        found = self.page.query_selector(selector)
        return found.inner_text() if found else ""

    def is_on(self, command: str) -> bool:
        found = self.page.query_selector(f"#do-{command}")
        return found is not None and found.get_attribute("aria-disabled") == "false"

    def hold(self, command: str, seconds: float = 1.3) -> None:
        until(lambda: self.is_on(command), f"{command} to be allowed")
        box = self.page.locator(f"#do-{command}").bounding_box()
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()
        time.sleep(seconds)
        self.page.mouse.up()

    def tap(self, command: str, *, times: int = 1) -> None:
        """Press a button; a twin within a second would count as the same command."""
        time.sleep(max(0.0, self._tapped_s.get(command, 0.0) + TWIN_S + 0.1 - time.monotonic()))
        until(lambda: self.is_on(command), f"{command} to be allowed")
        self.page.click(f"#do-{command}", click_count=times)
        self._tapped_s[command] = time.monotonic()

    def back_to_the_start(self) -> None:
        """English, and of the usual size."""
        self.page.set_viewport_size(SIZE)
        self.page.select_option("#language", "en")
        until(lambda: self.page.get_attribute("html", "lang") == "en", "English")

    def measured(self, cell: CellWithPage) -> None:
        """Measure where there is no result."""
        self.go("result")
        if self.page.query_selector("#values") is None:
            self.measure(cell)

    def measure(self, cell: CellWithPage) -> None:
        """Start the program and wait for its result."""
        before = len(cell.given("start_program", OperatorCommand.ACCEPTED))
        self.go("measure")
        self.hold("start_program")
        until(
            lambda: len(cell.given("start_program", OperatorCommand.ACCEPTED)) > before, "the start"
        )
        until(lambda: "running" in self.text("#program"), "the program to run")
        until(lambda: "finished" in self.text("#program"), "the program to end")
        self.go("result")
        until(lambda: self.page.query_selector("#values") is not None, "a result")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CellWithPage]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    folder = tmp_path_factory.mktemp("page")
    with cell_with_page(folder, port, tilt_rad=TILT_RAD, speed_factor=FASTER) as running:
        yield running


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=CHROMIUM,
            args=["--no-sandbox", f"--host-resolver-rules=MAP {STRANGER} 127.0.0.1"],
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def opened(cell: CellWithPage, browser: Any) -> Iterator[Screen]:
    shown = Screen(browser, cell.port)
    yield shown
    shown.context.close()


@pytest.fixture
def screen(opened: Screen) -> Iterator[Screen]:
    opened.errors.clear()  # told by the test that had them
    opened.back_to_the_start()
    yield opened
    assert opened.foreign == []
    assert opened.errors == []


POST = """async ([command, xsrf]) => {
  const answer = await fetch("/command", { method: "POST",
    headers: { "Content-Type": "application/json", ...(xsrf ? { "X-XSRFToken":
      document.cookie.split("; ").find((c) => c.startsWith("_xsrf=")).slice(6) } : {}) },
    body: JSON.stringify({ command, key: crypto.randomUUID(), arguments: {} }) });
  return [answer.status, await answer.text()];
}"""


def test_a_command_that_a_page_should_not_have_sent_is_refused_with_its_reason(
    cell: CellWithPage, screen: Screen
) -> None:
    """As from a page that was left open: the program runs, the pose is gone."""
    screen.go("measure")
    screen.hold("start_program")
    until(lambda: "running" in screen.text("#program"), "the program to run")
    before = len(cell.given("new_clamping", OperatorCommand.ASKED))
    for command, why in (("new_clamping", "The program runs"), ("hand_over", "hand.")):
        status, told = screen.page.evaluate(POST, [command, True])
        assert status == 200
        assert '"accepted": false' in told
        assert why in told
    assert screen.page.evaluate(POST, ["new_clamping", False])[0] == 403
    assert len(cell.given("new_clamping", OperatorCommand.ASKED)) == before
    until(lambda: "finished" in screen.text("#program"), "the program to end")


def test_a_report_of_the_measurement_so_far_is_made(cell: CellWithPage, screen: Screen) -> None:
    screen.measured(cell)
    screen.tap("make_report")
    until(lambda: screen.page.query_selector("#report") is not None, "the report")
    answer = screen.context.request.get(screen.page.get_attribute("#report", "href") and
        f"http://127.0.0.1:{cell.port}/report.pdf")  # fmt: skip
    assert answer.status == 200
    assert answer.body().startswith(b"%PDF-")


def test_a_part_is_aligned_in_three_corrections_and_handed_over(
    cell: CellWithPage, screen: Screen
) -> None:
    corrections = 0
    screen.measured(cell)
    before = len(cell.given("corrected", OperatorCommand.ACCEPTED))
    shown = max(1, len(screen.page.query_selector_all("#history tbody tr")))
    while "Good enough" not in screen.text("#advice"):
        assert corrections < 3, screen.text("main")
        screen.go("correct")
        screen.tap("corrected")
        corrections += 1
        until(
            lambda: len(cell.given("corrected", OperatorCommand.ACCEPTED)) == before + corrections,  # noqa: B023
            "the correction",
        )
        screen.measure(cell)
    assert cell.given("corrected", OperatorCommand.ACCEPTED)
    assert np.all(np.abs(cell.jacks.machine_T_part.euler_xyz_rad()[:2]) <= TOLERANCE_RAD)
    assert len(screen.page.query_selector_all("#history tbody tr")) == corrections + shown
    screen.go("hand")
    until(lambda: screen.is_on("hand_over"), "all conditions")
    asked = len(cell.given("hand_over", OperatorCommand.ASKED))
    screen.hold("hand_over", 0.4)  # too short: nothing happens
    time.sleep(1.0)
    assert len(cell.given("hand_over", OperatorCommand.ASKED)) == asked
    screen.hold("hand_over")
    until(lambda: "is equal" in screen.text("#handed"), "the read-back")
    assert "✓" in screen.text("#handed")
    with screen.page.expect_download() as download:
        screen.page.click("#file-siemens")
    assert "$P_UIFR[1] = CTRANS(X," in Path(download.value.path()).read_text()


LOOK_AT_IT = """() => ({
  width: document.documentElement.scrollWidth,
  buttons: [...document.querySelectorAll("button, a.button, select")].map((button) => {
    const box = button.getBoundingClientRect();
    return { what: button.id || button.innerText, main: button.classList.contains("main"),
      shown: box.width > 0, left: box.left, right: box.right, wide: box.width, high: box.height };
  }),
})"""


@pytest.mark.parametrize("size", SIZES)
def test_every_step_is_accessible_and_large_enough(
    cell: CellWithPage, screen: Screen, size: tuple[int, int]
) -> None:
    screen.page.set_viewport_size({"width": size[0], "height": size[1]})
    screen.measured(cell)
    for step in (*STEPS, "troubles"):
        screen.go(step)
        time.sleep(0.2)
        found = Axe().run(screen.page, options={"resultTypes": ["violations"]})
        assert found.violations_count == 0, found.generate_report()
        looked = screen.page.evaluate(LOOK_AT_IT)
        assert looked["width"] <= size[0]
        shown = [button for button in looked["buttons"] if button["shown"]]
        for button in shown:
            assert button["high"] >= (MAIN_PX if button["main"] else TARGET_PX) - 0.5, button
            assert button["wide"] >= TARGET_PX - 0.5, button
        steps = [b for b in shown if b["what"] in {f"step-{name}" for name in STEPS}]
        assert len(steps) == len(STEPS)  # always in sight
        assert all(b["left"] >= 0 and b["right"] <= size[0] for b in steps)
    screen.go("result")
    figure = screen.page.locator(".figure").first.evaluate(
        "e => parseFloat(getComputedStyle(e).fontSize)"
    )
    assert figure * 0.7 >= 26.0  # 7 mm; digits are 0.7 of the font's size


def test_values_of_an_estimator_that_stands_still_are_grey_with_their_age(
    cell: CellWithPage, screen: Screen
) -> None:
    screen.measured(cell)
    cell.send("estimator", signal.SIGSTOP)
    try:
        until(lambda: screen.page.query_selector("#values.stale") is not None, "grey values", 10.0)
        assert "Estimator: silent" in screen.text("#alarm")
        assert "old" in screen.text("#advice")
        screen.go("hand")
        assert not screen.is_on("hand_over")
        assert "✗" in screen.text("#condition-fresh")
    finally:
        cell.send("estimator", signal.SIGCONT)
    screen.go("result")
    until(lambda: screen.page.query_selector("#values:not(.stale)") is not None, "live values")


def test_a_lost_camera_is_told_and_comes_back(cell: CellWithPage, screen: Screen) -> None:
    screen.go("measure")
    until(lambda: screen.is_on("start_program"), "all stations")
    cell.send("camera", signal.SIGKILL)
    until(lambda: "Camera: silent" in screen.text("#alarm"), "the alarm", 10.0)
    assert not screen.is_on("start_program")
    cell.start("camera")
    until(lambda: screen.is_on("start_program"), "the camera to come back")
    screen.go("troubles")
    assert "The camera fell silent" in screen.text("#troubles")
    screen.page.click("#acknowledge-all")
    until(lambda: "Nothing is wrong" in screen.text("#troubles"), "the acknowledgement")


def test_a_lost_page_node_is_told_and_the_page_comes_back_without_reload(
    cell: CellWithPage, screen: Screen
) -> None:
    screen.go("measure")
    screen.page.evaluate_handle("() => { document.body.dataset.kept = 'yes'; }")
    cell.send("operator", signal.SIGKILL)
    until(lambda: "No connection" in screen.text("#alarm"), "the alarm", 10.0)
    screen.page.select_option("#language", "de")  # its words come when the node is back
    assert not screen.is_on("new_clamping")
    assert screen.page.query_selector("body.lost main.stale") is not None
    cell.start("operator")
    until(lambda: "No connection" not in screen.text("#alarm"), "the page to come back")
    until(lambda: screen.is_on("new_clamping"), "commands")
    until(lambda: screen.page.get_attribute("html", "lang") == "de", "the language")
    assert screen.page.query_selector("body[data-kept=yes]") is not None


@pytest.mark.parametrize("language", ["de", "es", "eu"])
def test_the_page_speaks_the_language_that_was_chosen(
    cell: CellWithPage, screen: Screen, language: str
) -> None:
    screen.measured(cell)
    english = {step: (screen.go(step), screen.text(f"#step-{step}"))[1] for step in STEPS}
    screen.page.select_option("#language", language)
    until(lambda: screen.page.get_attribute("html", "lang") == language, "the language")
    for step in STEPS:
        screen.go(step)
        assert screen.text(f"#step-{step}") != english[step]
    screen.go("result")
    figures = [e.inner_text() for e in screen.page.query_selector_all(".figure")]
    assert all("," in figure and "." not in figure for figure in figures)


def test_two_pages_show_the_same_and_a_double_tap_is_one_command(
    cell: CellWithPage, screen: Screen, browser: Any
) -> None:
    screen.measured(cell)
    other = Screen(browser, cell.port)
    for page in (screen, other):
        page.go("result")
    until(lambda: screen.text("#values tbody") == other.text("#values tbody") != "", "the same")
    before = len(cell.given("new_clamping", OperatorCommand.ASKED))
    screen.go("measure")
    screen.tap("new_clamping", times=2)
    until(lambda: "No longer true" in other.text("#advice"), "the other page to tell")
    time.sleep(0.5)
    assert len(cell.given("new_clamping", OperatorCommand.ASKED)) == before + 1
    screen.go("hand")
    assert not screen.is_on("hand_over")
    other.context.close()


@pytest.mark.parametrize(
    ("language", "missing", "refused"),
    [
        ("en", "no target of the part was seen yet", "Expected images of"),
        ("de", "Noch wurde keine Marke des Teils gesehen", "Erwartet wurden Bilder"),
        ("es", "aún no se vio ninguna diana", "Se esperaban imágenes"),
        ("eu", "oraindik ez da piezaren itutik ikusi", "pixeleko irudiak espero ziren"),
    ],
)
def test_missing_targets_and_refused_images_are_told_in_the_language(
    cell: CellWithPage, screen: Screen, language: str, missing: str, refused: str
) -> None:
    screen.page.select_option("#language", language)
    screen.go("measure")
    before = len(cell.given("new_clamping", OperatorCommand.ACCEPTED))
    screen.tap("new_clamping")
    until(
        lambda: len(cell.given("new_clamping", OperatorCommand.ACCEPTED)) > before, "the clamping"
    )
    until(lambda: screen.page.query_selector("#refused") is None, "all images to be forgotten")
    until(lambda: missing in screen.text("#missing"), "what is missing")
    cell.show_small_image()
    until(
        lambda: refused in (told := screen.text("#refused")) and "64 x 48" in told,
        "the refused image",
    )
    screen.go("troubles")
    assert refused in screen.text("#troubles")
    screen.page.click("#acknowledge-all")
    until(lambda: refused not in screen.text("#troubles"), "the acknowledgement")


def test_after_a_reload_the_page_is_where_it_was(cell: CellWithPage, screen: Screen) -> None:
    screen.go("correct")
    screen.page.reload()
    screen.page.wait_for_selector("main#correct")
    assert cell.processes["operator"].poll() is None


def test_every_topic_of_the_layouts_is_published(cell: CellWithPage) -> None:
    """Those for RViz and Foxglove, beside the nodes that they are for."""
    layouts = Path(get_package_share_directory("omm_operator")) / "layouts"
    named = {
        topic for path in layouts.iterdir()
        for topic in re.findall(r"[\"\s{](/[a-z_]+(?:/[a-z_]+)*)", path.read_text())
    }  # fmt: skip
    assert len(named) > 5
    for topic in named | {"/joint_states", "/tf", "/tf_static"}:
        until(lambda: cell.count_publishers(topic) > 0, topic)  # noqa: B023


LOOK = """async (own) => {
  const tried = {};
  const told = async (name, work) => {
    try { tried[name] = await work(); } catch (error) { tried[name] = "refused"; }
  };
  const mine = { credentials: "include" };
  await told("fetch", async () => (await fetch(own + "session", mine)).status);
  await told("post", async () => (await fetch(own + "command", { method: "POST",
    credentials: "include", headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ command: "new_clamping", key: "12345678", arguments: {} }) })).status);
  await told("live", () => new Promise((done, fail) => {
    const socket = new WebSocket(own.replace("http", "ws") + "live");
    socket.onopen = () => done("open");
    socket.onerror = () => fail(new Error("refused"));
  }));
  await told("picture", () => new Promise((done, fail) => {
    const picture = new Image();
    picture.onload = () => done("shown");
    picture.onerror = () => fail(new Error("refused"));
    picture.src = own + "picture.jpg";
  }));
  return tried;
}"""


class Nothing(http.server.BaseHTTPRequestHandler):
    """A page of somebody else."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<p>another site</p>")

    def log_message(self, *_: object) -> None:
        """Keep still."""


def test_another_sites_page_and_another_name_get_nothing(
    cell: CellWithPage, screen: Screen
) -> None:
    before = len(cell.given("new_clamping", OperatorCommand.ASKED))
    own = f"http://127.0.0.1:{cell.port}/"
    with http.server.HTTPServer(("127.0.0.1", 0), Nothing) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        context = screen.page.context.browser.new_context()
        page = context.new_page()
        page.goto(own)  # this browser has a session
        page.wait_for_selector("main")
        page.goto(f"http://127.0.0.1:{other.server_port}/")
        tried = page.evaluate(LOOK, own)
        rebound = page.goto(f"http://{STRANGER}:{cell.port}/")
        other.shutdown()
    assert tried == dict.fromkeys(("fetch", "post", "live", "picture"), "refused")
    assert rebound is not None
    assert rebound.status == 421
    context.close()
    assert len(cell.given("new_clamping", OperatorCommand.ASKED)) == before


def test_every_command_is_in_the_recording_with_who_and_when(cell: CellWithPage) -> None:
    cell.send("recorder", signal.SIGINT)
    cell.processes["recorder"].wait(30.0)
    with open(cell.folder / "run.mcap", "rb") as file:
        messages = make_reader(file).iter_messages(topics=["/omm/operator_commands"])
        assert len(list(messages)) == len(cell.commands) > 10
    assert all(c.who.startswith("127.0.0.1 ") and c.role == "operator" for c in cell.commands)
