"""Bags that were reindexed, split or killed are read, or refused with what helps."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from omm_core.errors import InputError
from omm_recording.repairing import repair, repaired_name
from omm_recording.run_files import find_run, to_repair

METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: '{storage}'
  relative_file_paths: [{files}]
"""


def bag(folder: Path, record: Any, *names: str) -> Path:
    """Fill a folder with files of a recording under these names."""
    folder.mkdir()
    whole = record("source")
    for name in names:
        shutil.copyfile(whole, folder / name)
    return folder


def test_a_reindexed_bag_without_a_storage_is_read_by_its_names(
    tmp_path: Path, record: Any
) -> None:
    folder = bag(tmp_path / "bag", record, "bag_0.mcap")
    (folder / "metadata.yaml").write_text(METADATA.format(storage="", files="bag_0.mcap"))
    assert find_run(folder).recordings == (folder / "bag_0.mcap",)
    (folder / "bag_0.db3").write_bytes(b"SQLite format 3\x00")
    (folder / "metadata.yaml").write_text(METADATA.format(storage="", files="bag_0.db3"))
    with pytest.raises(InputError, match="got sqlite3"):
        find_run(folder)


def test_split_files_without_metadata_are_one_recording_in_the_order_of_their_numbers(
    tmp_path: Path, record: Any
) -> None:
    names = [f"bag_{n}.mcap" for n in range(11)]
    folder = bag(tmp_path / "bag", record, *names)
    assert [file.name for file in find_run(folder).recordings] == names
    (folder / "bag_3.mcap").unlink()
    with pytest.raises(InputError, match="ros2 bag reindex"):
        find_run(folder)


def test_a_killed_bag_is_repaired_by_its_folder_and_then_read(
    tmp_path: Path, record: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = bag(tmp_path / "bag", record, "bag_0.mcap", "bag_1.mcap")
    cut = folder / "bag_1.mcap"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 2 // 3])
    assert to_repair(folder) == cut
    assert repair(cut, repaired_name(cut)).messages > 0
    names = [file.name for file in find_run(folder).recordings]
    assert names == ["bag_0.mcap", "bag_1.repaired.mcap"]
    assert "bag_1.repaired.mcap is read in place of bag_1.mcap" in capsys.readouterr().err


def test_what_is_missing_or_sqlite_is_told_with_what_helps(tmp_path: Path, record: Any) -> None:
    folder = bag(tmp_path / "bag", record, "bag_0.mcap")
    (folder / "metadata.yaml").write_text(METADATA.format(storage="mcap", files="gone_0.mcap"))
    with pytest.raises(InputError, match="ros2 bag reindex"):
        find_run(folder)
    other = tmp_path / "other"
    other.mkdir()
    (other / "bag_0.db3").write_bytes(b"SQLite format 3\x00")
    with pytest.raises(InputError, match="ros2 bag convert"):
        find_run(other)
