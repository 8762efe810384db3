"""What is written destroys nothing that stood there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from omm_core.errors import InputError
from omm_core.files.output import take_folder, write_whole


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    target.write_text("old")
    link.symlink_to(target)
    write_whole(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_a_fifo_that_nobody_reads_is_told_and_stays(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(InputError):
        write_whole(fifo, "x")
    assert fifo.is_fifo()


def test_a_folder_belongs_to_one_process(tmp_path: Path) -> None:
    take_folder(tmp_path)
    script = "import sys, pathlib; from omm_core.files.output import take_folder\n"
    script += "take_folder(pathlib.Path(sys.argv[1]))"
    other = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert "Another process writes into" in other.stderr
