"""What killed processes leave in shared memory is removed; what the living use is not."""

import contextlib
import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from omm_ros.shared_memory import remove_leftovers


def segment(folder: Path, name: str, age_s: float) -> Path:
    path = folder / name
    for file in (path, folder / f"{name}_el"):
        file.write_bytes(b"")
        os.utime(file, (time.time() - age_s,) * 2)
    return path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_only_old_segments_without_an_owner_go(tmp_path: Path) -> None:
    segment(tmp_path, "fastrtps_00000000000000aa", 100.0)
    living = segment(tmp_path, "fastrtps_00000000000000bb", 100.0)
    segment(tmp_path, "fastrtps_00000000000000cc", 0.0)
    segment(tmp_path, "sem.fastrtps_port7000_mutex", 100.0)
    before = names(tmp_path)
    with open(f"{living}_el", "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert remove_leftovers(tmp_path) == 1
    assert before - names(tmp_path) == {
        "fastrtps_00000000000000aa",
        "fastrtps_00000000000000aa_el",
    }


def test_a_segment_of_unknown_ownership_stays(tmp_path: Path) -> None:
    path = segment(tmp_path, "fastrtps_00000000000000aa", 100.0)
    (tmp_path / f"{path.name}_el").unlink()
    assert remove_leftovers(tmp_path) == 0
    assert path.exists()


def test_a_machine_without_the_folder_is_left_in_peace(tmp_path: Path) -> None:
    assert remove_leftovers(tmp_path / "none") == 0


_PROGRAM = """
import rclpy, time
rclpy.init()
node = rclpy.create_node("some_node")
print("up", flush=True)
time.sleep(60)
"""


@contextlib.contextmanager
def node_with_segments() -> Iterator[tuple["subprocess.Popen[str]", set[str]]]:
    """A node as a process, and the names of the segments that it made (made to look old)."""
    shared = Path("/dev/shm")
    before = names(shared)
    with subprocess.Popen(
        [sys.executable, "-c", _PROGRAM], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "up\n"
            made = {n for n in names(shared) - before if len(n) == len("fastrtps_") + 16}
            assert made
            for name in made:
                os.utime(shared / name, (time.time() - 100,) * 2)
            yield process, made
        finally:
            process.kill()


def test_a_killed_node_leaves_a_segment_that_goes_and_a_living_one_keeps_its_own() -> None:
    """Against the real middleware: its names and locks are what the module takes them for."""
    with node_with_segments() as (killed, left), node_with_segments() as (_, used):
        killed.kill()
        killed.wait()
        remove_leftovers()
        there = names(Path("/dev/shm"))
        assert not left & there
        assert used <= there
    remove_leftovers()
