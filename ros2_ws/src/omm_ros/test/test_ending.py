"""What a process does when it, or the one that started it, is told to end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")

ENDING_FOR_GOOD = """
import sys, time
from omm_ros.interrupt import told_to_end
with told_to_end(for_good=True) as ended:
    print("ready", flush=True)
    assert ended.wait(30.0)
print("closing", flush=True)
time.sleep(2.0)  # longer than what counts as one wish
print("closed", flush=True)
"""
CHILD = """
import signal, sys, time
from omm_ros.node_main import end_with_parent
def closed(number, frame):
    open(sys.argv[1], "w").write(str(number))
    sys.exit()
signal.signal(signal.SIGTERM, closed)
end_with_parent()
print("ready", flush=True)
time.sleep(30.0)
"""
PARENT = f"""
import subprocess, sys, time
subprocess.Popen([sys.executable, "-c", {CHILD!r}, sys.argv[1]])
time.sleep(30.0)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_no_further_signal_interrupts_what_is_closing_for_good(number: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", ENDING_FOR_GOOD],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    assert process.stdout.readline() == "closing\n"
    for _ in range(6):
        process.send_signal(number)
        time.sleep(0.3)
    told, wrong = process.communicate(timeout=30)
    assert (process.returncode, told, wrong) == (0, "closed\n", "")


def test_a_node_ends_cleanly_with_the_process_that_started_it_where_that_is_wished(
    tmp_path: Path,
) -> None:
    mark = tmp_path / "closed"
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(mark)],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "OMM_END_WITH_PARENT": "1"},
    )  # fmt: skip
    assert parent.stdout is not None
    assert parent.stdout.readline() == "ready\n"
    parent.kill()
    parent.wait()
    deadline_s = time.monotonic() + 20.0
    while not mark.exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert mark.read_text() == str(int(signal.SIGTERM))
    parent.stdout.close()


def test_a_thread_that_is_left_is_not_waited_for_and_the_status_is_kept() -> None:
    program = """
import atexit, sys, threading, time
from omm_ros.leaving import end_process, leave
atexit.register(time.sleep, 60.0)  # as a compiler's library keeps Python's end
thread = threading.Thread(target=time.sleep, args=(60.0,), daemon=True)
thread.start()
leave(thread)
print("all is closed")
sys.exit(end_process(3))
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=40, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "all is closed\n", "")
