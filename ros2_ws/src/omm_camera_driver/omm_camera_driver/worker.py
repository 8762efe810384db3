"""The one thread that talks to the camera, and what it does when the camera goes away.

    inactive ──▶ absent ──▶ opening ──▶ streaming ──▶ lost ──▶ opening ──▶ …

Nothing else calls the driver: device calls block (a GigE camera that was unplugged keeps `close`
for seconds), and nobody who must answer may wait for them. After a loss the old connection is
closed on a thread of its own, and a new one is opened as soon as that has ended.
"""

import math
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

from omm_camera_driver.clocks import WallClock
from omm_camera_driver.driver import (
    CameraDriver,
    CameraSettings,
    Frame,
    FrameLost,
    Trigger,
)
from omm_camera_driver.pixels import without_contrast
from omm_camera_driver.worker_status import Listener, Status, WorkerState, why_not
from omm_core.errors import DeviceError, InputError, OmmError
from omm_core.words import of_error

# A camera that came back must be in use again within 2 s, so it is looked for more often.
_RETRY_S = 0.25
_CHECK_S = 0.5
_WAIT_FOR_FRAME_S = 0.1
_RATE_WINDOW_S = 5.0
# A camera that runs by itself and sends nothing for so long is not streaming, whatever it says.
_SILENT_S = 3.0
_LOST_NEWS_S = 10.0


@dataclass(kw_only=True, eq=False)
class _ImageRequest:
    asked_ns: int  # monotonic
    deadline_s: float
    future: "Future[int]" = field(default_factory=Future)


class CameraWorker:
    """Keeps one camera connected and delivers its frames.

    Parameters
    ----------
    make_driver : a driver for a new connection
    settings : applied at every connection
    listener : gets frames and news
    trigger_timeout_s : how long a triggered image may take
    wall : the system's clock
    """

    def __init__(
        self,
        make_driver: Callable[[], CameraDriver],
        settings: CameraSettings,
        listener: Listener,
        *,
        trigger_timeout_s: float = 3.0,
        wall: WallClock | None = None,
    ) -> None:
        self._make_driver = make_driver
        self._settings = settings
        self._listener = listener
        self._trigger_timeout_s = trigger_timeout_s
        self._wall = wall or WallClock()
        self._status = Status()
        self._requests: deque[_ImageRequest] = deque()
        self._changes: deque[tuple[str, float, Future[float]]] = deque()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._published_at: deque[float] = deque(maxlen=256)
        self._connected_s = self._lost_s = self._set_s = -math.inf
        self._last_sequence: int | None = None
        self._shows_nothing = ""

    # --- called from anywhere ---

    def start(self) -> None:
        """Begin to connect; returns at once."""
        self._stopping.clear()
        self._status = replace(self._status, state=WorkerState.ABSENT, problem="", camera=None)
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def stop(self, timeout_s: float = 1.0) -> bool:
        """End the thread; return False while the device blocks it (it then ends by itself)."""
        self._stopping.set()
        self._wake.set()
        self._refuse_all("The camera is being stopped.")
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        thread.join(timeout_s)
        return not thread.is_alive()

    def request_image(self) -> "Future[int]":
        """Ask for one image; the future gives its stamp in ns once it has been published."""
        now_ns = time.monotonic_ns()
        request = _ImageRequest(asked_ns=now_ns, deadline_s=now_ns / 1e9 + self._trigger_timeout_s)
        status = self.status()
        if status.state is not WorkerState.STREAMING or self._stopping.is_set():
            request.future.set_exception(DeviceError(why_not(status)))
            return request.future
        self._requests.append(request)
        self._wake.set()
        return request.future

    def change(self, name: str, value: float) -> "Future[float]":
        """Change exposure_us or gain, now and at every later connection."""
        future: Future[float] = Future()
        if self._status.state is not WorkerState.STREAMING:
            self._settings = replace(self._settings, **{name: value})  # type: ignore[arg-type]
            future.set_result(value)
            return future
        self._changes.append((name, value, future))
        self._wake.set()
        return future

    def status(self) -> Status:
        """Return what is known now."""
        now_s = time.monotonic()
        if self._thread is None:
            return replace(self._status, state=WorkerState.INACTIVE, problem="", camera=None)
        if not self._thread.is_alive() and not self._stopping.is_set():
            return replace(
                self._status, state=WorkerState.LOST, problem=self._status.problem or _DEAD
            )
        recent = [t for t in list(self._published_at) if now_s - t < _RATE_WINDOW_S]
        rate_hz = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0
        problem = self._status.problem or self._unearned(now_s)
        return replace(self._status, rate_hz=rate_hz, problem=problem)

    def _unearned(self, now_s: float) -> str:
        """Return what speaks against a connection that says nothing of itself; mostly nothing."""
        if self._status.state is not WorkerState.STREAMING:
            return ""
        exposure_s = (self._granted("exposure_us") or 0.0) / 1e6
        rate_hz = self._granted("frame_rate_hz")
        period_s = 1.0 / rate_hz if rate_hz else 0.0
        silent_s = now_s - max([self._connected_s, *list(self._published_at)[-1:]])
        if self._settings.trigger is Trigger.CONTINUOUS and silent_s > (
            _SILENT_S + 2.0 * (exposure_s + period_s)
        ):
            return f"The camera runs by itself, but no image has come for {silent_s:.0f} s."
        if now_s - self._lost_s < _LOST_NEWS_S:
            return f"Images were lost on the way within the last {_LOST_NEWS_S:.0f} s."
        if now_s - self._set_s < _LOST_NEWS_S:
            return f"The system's clock was set within the last {_LOST_NEWS_S:.0f} s."
        return self._shows_nothing

    def _granted(self, name: str) -> float | None:
        """Return exposure or rate: what was asked for, or else what the camera told of itself."""
        camera = self._status.camera
        told = camera.granted.get(name) if camera is not None else None
        asked: float | None = getattr(self._settings, name)
        return asked or (float(told) if isinstance(told, int | float) else None)

    # --- the thread ---

    def _run(self) -> None:
        """Keep the camera connected; what ends the thread all the same is told."""
        try:
            self._keep_connected()
        except Exception as error:
            traceback.print_exc()
            problem = f"The camera's thread has ended: {type(error).__name__}: {error}"
            self._status = replace(self._status, state=WorkerState.LOST, problem=problem)
            self._refuse_all(problem)
            self._listener.on_problem(problem)

    def _keep_connected(self) -> None:
        while not self._stopping.is_set():
            driver: CameraDriver | None = None
            try:
                driver = self._make_driver()
                self._connect(driver)
                self._stream(driver)
            except OmmError as error:
                self._failed(of_error(error))
            except Exception as error:  # a driver's defect must not end the camera for good
                if self._failed(f"{type(error).__name__} in the driver: {error}"):
                    traceback.print_exc()
            finally:
                if driver is not None:
                    self._dispose(driver)
            self._stopping.wait(_RETRY_S)

    def _connect(self, driver: CameraDriver) -> None:
        self._status = replace(self._status, state=WorkerState.OPENING)
        camera = driver.open(self._settings)
        driver.start()
        self._last_sequence = None
        self._shows_nothing = ""
        self._connected_s = time.monotonic()
        self._status = replace(
            self._status,
            state=WorkerState.STREAMING,
            problem="",
            camera=camera,
            connections=self._status.connections + 1,
        )
        self._listener.on_connected(camera)

    def _failed(self, problem: str) -> bool:
        """Take note of a problem; tells whether it is a new one."""
        was_connected = self._status.camera is not None
        state = WorkerState.LOST if was_connected else WorkerState.ABSENT
        news = problem != self._status.problem
        self._status = replace(self._status, state=state, problem=problem)
        self._refuse_all(why_not(self._status))
        if news:
            self._listener.on_problem(problem)
        return news

    def _dispose(self, driver: CameraDriver) -> None:
        """Close on a separate thread, so that stopping need not wait for a device's time-outs."""
        failed: list[Exception] = []

        def close() -> None:
            try:
                driver.close()
            except Exception as error:
                failed.append(error)

        closing = threading.Thread(target=close, name="camera closing", daemon=True)
        closing.start()
        while closing.is_alive() and not self._stopping.is_set():
            closing.join(0.05)
        closing.join(0.5)
        for error in failed:
            self._listener.on_problem(f"The camera could not be closed: {error}")

    def _stream(self, driver: CameraDriver) -> None:
        camera = self._status.camera
        on_demand = self._settings.trigger is Trigger.SOFTWARE
        triggers = on_demand and camera is not None and camera.has_software_trigger
        checked_s = time.monotonic()
        while not self._stopping.is_set():
            self._apply_changes(driver)
            if triggers:
                self._wake.wait(_CHECK_S)
                self._wake.clear()
                while self._requests and not self._stopping.is_set():
                    self._take_triggered(driver, self._requests.popleft())
            else:
                self._take_next(driver, only_asked_for=on_demand)
            if time.monotonic() - checked_s > _CHECK_S:
                self._was_set()
                driver.check()
                self._status = replace(self._status, health=driver.health())
                checked_s = time.monotonic()

    def _apply_changes(self, driver: CameraDriver) -> None:
        while self._changes:
            name, value, future = self._changes.popleft()
            try:
                granted = driver.set(name, value)
            except InputError as error:
                future.set_exception(error)
            except DeviceError as error:
                future.set_exception(error)
                raise
            else:
                self._settings = replace(self._settings, **{name: value})  # type: ignore[arg-type]
                future.set_result(granted)

    def _take_triggered(self, driver: CameraDriver, request: _ImageRequest) -> None:
        """Trigger, and publish the image that was exposed after that, no older one."""
        try:
            self._was_set()
            driver.flush()
            driver.trigger()
            frame = self._frame_after(driver, request)
        except FrameLost as error:
            self._unanswered(request, str(error))
            return
        except DeviceError as error:
            request.future.set_exception(DeviceError(str(error)))
            raise
        if frame is None:
            self._unanswered(
                request,
                f"Expected an image within {self._trigger_timeout_s:g} s of the trigger, got none. "
                "Where this repeats, check the network (lost packets) and the exposure time.",
            )
            return
        self._publish(frame)
        request.future.set_result(frame.exposure_mid_ns)

    def _frame_after(self, driver: CameraDriver, request: _ImageRequest) -> Frame | None:
        retried = False
        while not self._stopping.is_set():
            left_s = request.deadline_s - time.monotonic()
            if left_s <= 0.0:
                driver.check()
                return None
            frame = driver.next_frame(min(left_s, _WAIT_FOR_FRAME_S))
            if frame is None:
                continue
            if not self._usable(frame) or self._was_set():
                if not retried:  # what was lost on the way is asked for once more
                    retried = True
                    driver.trigger()
                continue
            if self._is_exposed_after(frame, request):
                return frame
            self._status = replace(self._status, stale=self._status.stale + 1)
        return None

    def _take_next(self, driver: CameraDriver, *, only_asked_for: bool) -> None:
        try:
            frame = driver.next_frame(_WAIT_FOR_FRAME_S)
        except FrameLost as error:
            news = not self._status.problem
            self._status = replace(self._status, problem=of_error(error))
            if news:
                self._listener.on_problem(str(error))
            frame = None
        self._expire_requests()
        was_set = self._was_set()
        if frame is None or not self._usable(frame) or was_set:
            return
        answered = [r for r in list(self._requests) if self._is_exposed_after(frame, r)]
        if only_asked_for and not answered:
            return
        self._publish(frame)
        for request in answered:
            self._requests.remove(request)
            request.future.set_result(frame.exposure_mid_ns)

    def _was_set(self) -> bool:
        """Look whether the system's clock was set since the last look, and tell it.

        An image of that moment may be stamped by the one or the other: it is not used.
        """
        step = self._wall.look()
        if step is None:
            return False
        self._set_s = time.monotonic()
        self._status = replace(self._status, clock_steps=self._status.clock_steps + 1)
        self._listener.on_problem(str(step))
        return True

    def _is_exposed_after(self, frame: Frame, request: _ImageRequest) -> bool:
        begin_ns = self._wall.monotonic_of(frame.exposure_mid_ns - frame.exposure_ns // 2)
        unsure_ns = frame.stamp_uncertainty_ns + 2 * self._wall.unsure_ns  # there and back
        return begin_ns + unsure_ns >= request.asked_ns

    def _usable(self, frame: Frame) -> bool:
        """Count what was lost on the way, and tell whether this image is whole."""
        status = self._status
        if not frame.complete:
            self._lost_s = time.monotonic()
        if self._last_sequence is not None and frame.sequence > self._last_sequence + 1:
            missing = frame.sequence - self._last_sequence - 1
            status = replace(status, missing=status.missing + missing)
            self._lost_s = time.monotonic()
        self._last_sequence = frame.sequence
        if not frame.complete:
            status = replace(status, incomplete=status.incomplete + 1)
        self._status = status
        return frame.complete

    def _publish(self, frame: Frame) -> None:
        self._listener.on_frame(frame)
        self._published_at.append(time.monotonic())
        self._shows_nothing = without_contrast(frame.image)
        self._status = replace(
            self._status,
            problem="",
            published=self._status.published + 1,
            stamp_uncertainty_ns=frame.stamp_uncertainty_ns,
        )

    def _expire_requests(self) -> None:
        while self._requests and self._requests[0].deadline_s < time.monotonic():
            self._unanswered(
                self._requests.popleft(),
                f"Expected an image within {self._trigger_timeout_s:g} s, got none.",
            )

    def _unanswered(self, request: _ImageRequest, problem: str) -> None:
        count = self._status.unanswered_triggers + 1
        self._status = replace(self._status, unanswered_triggers=count, problem=problem)
        request.future.set_exception(DeviceError(problem))

    def _refuse_all(self, problem: str) -> None:
        while self._requests:
            try:
                request = self._requests.popleft()
            except IndexError:  # the other thread was faster
                return
            request.future.set_exception(DeviceError(problem))
        while self._changes:
            name, value, future = self._changes.popleft()
            self._settings = replace(self._settings, **{name: value})  # type: ignore[arg-type]
            future.set_result(value)


_DEAD = "The camera's thread has ended."
