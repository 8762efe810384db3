"""What the camera tests share: a simulated GigE camera as a process, and a listener."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omm_camera_driver.driver import Camera, Frame

ADDRESS = "127.0.0.1"
HERE = Path(__file__).parent


class CameraProcess:
    """A simulated GigE camera in a process of its own."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def start(self, lost: float = 0.0) -> float:
        """Switch it on; returns when it answers, with the time (monotonic)."""
        command = [sys.executable, str(HERE / "gige_camera_process.py"), ADDRESS, str(lost)]
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path))
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"
        return time.monotonic()

    def kill(self) -> None:
        """Cut its power."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._process = None

    def pull(self) -> None:
        """Pull its cable: it says nothing more, and hears nothing in time."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def plug_in(self) -> float:
        """Plug its cable in again; returns the time (monotonic)."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)
        return time.monotonic()


class Recorder:
    """A listener that keeps what it hears."""

    def __init__(self) -> None:
        self.frames: list[tuple[Frame, NDArray[np.generic]]] = []
        self.cameras: list[Camera] = []
        self.problems: list[str] = []
        self._news = threading.Condition()

    def on_frame(self, frame: Frame) -> None:
        with self._news:
            self.frames.append((frame, frame.image.copy()))
            self._news.notify_all()

    def on_connected(self, camera: Camera) -> None:
        with self._news:
            self.cameras.append(camera)
            self._news.notify_all()

    def on_problem(self, problem: str) -> None:
        with self._news:
            self.problems.append(problem)
            self._news.notify_all()

    def wait_for(self, condition: Callable[["Recorder"], bool], timeout_s: float = 20.0) -> bool:
        """Whether the condition came true in time."""
        with self._news:
            return self._news.wait_for(lambda: condition(self), timeout_s)
