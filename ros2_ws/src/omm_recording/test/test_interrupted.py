"""What a killed recorder left is kept, named, and in nobody's way."""

from pathlib import Path

from omm_recording.interrupted import interrupted, set_aside
from omm_recording.run_files import UNFINISHED, to_repair
from omm_recording.writing import RecordingOptions, RecordingWriter


def test_what_was_interrupted_is_set_aside_and_kept(tmp_path: Path) -> None:
    left = tmp_path / f"run.mcap{UNFINISHED}"
    kept = []
    for content in (b"first", b"second"):  # within one second, too
        left.write_bytes(content)
        aside = set_aside(tmp_path / "run.mcap")
        assert aside is not None
        kept.append(aside)
        assert not left.exists()
    assert [path.read_bytes() for path in kept] == [b"first", b"second"]
    assert sorted(interrupted(tmp_path)) == sorted(kept)


def test_what_is_being_written_is_never_set_aside(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    assert set_aside(tmp_path / "run.mcap") is None
    assert interrupted(tmp_path) == []
    writer.close({})
    assert set_aside(tmp_path / "run.mcap") is None


def test_what_was_repaired_is_not_told_of_again(tmp_path: Path) -> None:
    left = tmp_path / f"run.mcap{UNFINISHED}"
    left.write_bytes(b"left")
    assert interrupted(tmp_path) == [left]
    (tmp_path / "run.mcap").write_bytes(b"repaired")
    assert interrupted(tmp_path) == []
    assert set_aside(tmp_path / "run.mcap") is None


def test_repair_takes_the_interrupted_one_beside_the_one_under_way(tmp_path: Path) -> None:
    (tmp_path / f"run.mcap{UNFINISHED}").write_bytes(b"left")
    aside = set_aside(tmp_path / "run.mcap")
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions())
    assert to_repair(tmp_path) == aside
    writer.close({})
