"""Files whose names are not UTF-8 (an old camera's card) are read, written and told."""

import json
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest

NAME = b"Stra\xdfe 1.png"


@pytest.fixture
def folder(tmp_path):
    """A grey picture under a Latin-1 name."""
    path = os.path.join(os.fsencode(tmp_path), NAME)
    data = cv2.imencode(".png", np.full((60, 80), 120, np.uint8))[1].tobytes()
    try:
        with open(path, "wb") as file:
            file.write(data)
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    return tmp_path


def omm(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "omm_bringup.command_line", *arguments],
        capture_output=True, timeout=60, check=False,
    )  # fmt: skip


def test_an_overlay_is_drawn_beside_and_the_name_is_told_as_it_is(folder):
    out = folder / "out.json"
    image = os.path.join(os.fsencode(folder), NAME)
    done = omm(b"detect", image, b"--family", b"aicon12", b"--overlay", b"--json", bytes(out))
    assert done.returncode == 0, done.stderr
    assert os.path.join(os.fsencode(folder), b"Stra\xdfe 1_targets.png") in done.stdout
    assert b"Stra\xdfe 1_targets.png" in os.listdir(os.fsencode(folder))
    assert json.loads(out.read_text())


@pytest.mark.parametrize("command", ["detect", "solve", "info"])
def test_a_name_that_is_not_there_is_told_without_a_traceback(tmp_path, command):
    missing = os.path.join(os.fsencode(tmp_path), NAME)
    family = [b"--family", b"aicon12"] if command == "detect" else []
    done = omm(command.encode(), missing, *family)
    assert done.returncode in (1, 2)
    assert b"Traceback" not in done.stderr
    assert b"omm:" in done.stderr
