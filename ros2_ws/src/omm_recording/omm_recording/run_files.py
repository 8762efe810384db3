"""Which files make a run: the recording, and the part and the camera beside it."""

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from omm_core.errors import InputError, warn
from omm_core.files.yaml_input import read_yaml
from omm_recording.new_file import being_written

_LARGEST_UNPACKED = 256 << 20
UNFINISHED = ".unfinished"


@dataclass(frozen=True, kw_only=True)
class RunFiles:
    """The files of one run. `recordings` are in the order in which they were written."""

    folder: Path
    recordings: tuple[Path, ...]

    def beside(self, name: str) -> Path | None:
        """Return a file that lies beside the recording, if it is there."""
        path = self.folder / name
        return path if path.is_file() else None


def find_run(run: Path) -> RunFiles:
    """Find the files of a run.

    Parameters
    ----------
    run
        An MCAP file, a folder with ``run.mcap``, or a folder that rosbag2 made.

    Raises
    ------
    InputError
        If there is nothing of the kind.
    """
    if run.is_dir():
        return _in_folder(run)
    if not run.exists():
        raise InputError(f"Expected a recording, got {run}, which does not exist.")
    if not run.is_file():
        raise InputError(f"Expected an MCAP file or a folder with one, got {run}.")
    return RunFiles(folder=run.parent, recordings=(run,))


def _in_folder(folder: Path) -> RunFiles:
    single = folder / "run.mcap"
    if single.is_file():
        return RunFiles(folder=folder, recordings=(single,))
    if (folder / "metadata.yaml").is_file():
        return RunFiles(folder=folder, recordings=_listed(folder))
    unfinished = sorted(folder.glob(f"*{UNFINISHED}"))
    if unfinished:
        raise InputError(
            f"The recording {unfinished[0]} was never closed: it is still being written, or it was "
            f"interrupted. If nothing is writing to it any more: ./omm repair {unfinished[0]}"
        )
    others = _with_repaired(sorted(folder.glob("*.mcap")))
    if len(others) == 1 or _is_one_bag(others):
        return RunFiles(folder=folder, recordings=tuple(sorted(others, key=_number)))
    if not others and any(folder.glob("*.db3")):
        raise InputError(_not_mcap("sqlite3", folder))
    compressed = sorted(folder.glob("*.mcap.zst*"))
    if not others and len(compressed) == 1:
        return RunFiles(folder=folder, recordings=tuple(compressed))
    if not others and (bags := sorted(folder.glob("*.bag"))):
        raise InputError(_not_mcap("a bag of ROS 1", bags[0]))
    got = f"{', '.join(c.name for c in compressed)}; name one of them" if compressed else "none"
    if others:
        got = (
            f"{len(others)} other MCAP files; name one of them, or if they are one recording: "
            f"ros2 bag reindex {folder}"
        )
    raise InputError(f"Expected run.mcap or a rosbag2 recording in {folder}, got {got}.")


_SPLIT = re.compile(r"(?P<name>.+)_(?P<number>\d+)(?:\.repaired)?")
"""rosbag2 numbers the files of one recording from 0."""
_REPAIRED = ".repaired"


def _number(file: Path) -> int:
    match = _SPLIT.fullmatch(file.stem)
    return int(match["number"]) if match else 0


def _is_one_bag(files: list[Path]) -> bool:
    """Whether they are called as rosbag2 calls the files of one recording, and none is missing."""
    matches = [_SPLIT.fullmatch(file.stem) for file in files]
    names = {match["name"] for match in matches if match}
    numbers = sorted(int(match["number"]) for match in matches if match)
    return bool(files) and len(names) == 1 and numbers == list(range(len(files)))


def _with_repaired(files: list[Path]) -> list[Path]:
    """Take a repaired file in the place of the one it was made from."""
    taken = []
    for file in files:
        repaired = file.with_name(f"{file.stem}{_REPAIRED}.mcap")
        if repaired.is_file():
            warn(f"{repaired.name} is read in place of {file.name}, from which it was made.")
        else:
            repaired = file
        if repaired not in taken:
            taken.append(repaired)
    return taken


def _not_mcap(storage: str, folder: Path) -> str:
    return (
        f"Expected a recording in MCAP, got {storage} in {folder}. "
        "Convert it: ros2 bag convert, or rosbags-convert --dst-storage mcap."
    )


def _listed(folder: Path) -> tuple[Path, ...]:
    """Return the files that rosbag2's metadata.yaml names."""
    path = folder / "metadata.yaml"
    root = read_yaml(path, "metadata of a rosbag2 recording").values
    try:
        information: dict[str, Any] = root["rosbag2_bagfile_information"]
        # Old versions wrote the paths relative to the folder above.
        files = [folder / Path(name).name for name in information["relative_file_paths"]]
        storage = information["storage_identifier"]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is not the metadata.yaml of rosbag2: {error}") from error
    # `ros2 bag reindex` of Humble leaves the storage empty: then the names tell.
    if not storage:
        storage = "sqlite3" if any(file.suffix == ".db3" for file in files) else "mcap"
    if storage != "mcap":
        raise InputError(_not_mcap(str(storage), folder))
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise InputError(
            f"{path} names files that are missing: {', '.join(missing) or 'none named'}. If the "
            f"recording is all there under other names: ros2 bag reindex {folder}"
        )
    return tuple(_with_repaired(files))


_MAGIC = b"\x89MCAP0\r\n"


def to_repair(folder: Path) -> Path:
    """Find the file of a folder that was not closed.

    Raises
    ------
    InputError
        If there is not just one.
    """
    found = sorted(folder.glob(f"*{UNFINISHED}"))
    found = [file for file in found if not being_written(file)] or found
    if not found:
        whole = sorted(folder.glob("*.mcap"))
        found = [file for file in whole if not _is_closed(file)]
        if not found and len(whole) == 1:
            return whole[0]
    if len(found) == 1:
        return found[0]
    names = ", ".join(file.name for file in found)
    raise InputError(
        f"Expected one recording in {folder} that was not closed, found {len(found)}"
        + (f" ({names}): name one." if found else ": name the file that is to be repaired.")
    )


def _is_closed(file: Path) -> bool:
    """Whether a file ends as MCAP ends."""
    try:
        with file.open("rb") as opened:
            opened.seek(max(file.stat().st_size - len(_MAGIC), 0))
            return opened.read() == _MAGIC
    except OSError as error:
        raise InputError(f"Cannot read {file}: {error.strerror}.") from error


def open_recording(path: Path) -> IO[bytes]:
    """Open a recording for reading; one that was compressed as a whole file is unpacked first.

    Unpacking goes to a temporary file without a name, so that nothing is left behind.
    """
    try:
        if not path.is_file():  # a FIFO would wait for ever
            raise InputError(f"Expected an MCAP file, got {path}, which is not an ordinary file.")
        file = path.open("rb")
        start = file.read(4)
        file.seek(0)
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    if start != b"\x28\xb5\x2f\xfd":
        return file
    import zstandard

    unpacked = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
    # Images have noise: what shrinks to less than a hundredth is no recording.
    limit = max(_LARGEST_UNPACKED, 100 * path.stat().st_size)
    try:
        with file, zstandard.ZstdDecompressor().stream_reader(file) as reader:
            while piece := reader.read(8 << 20):
                unpacked.write(piece)
                if unpacked.tell() > limit:
                    raise InputError(
                        f"{path} unpacks to more than {limit >> 20} MB: that is not a recording."
                    )
    except (zstandard.ZstdError, OSError) as error:
        raise InputError(f"{path} cannot be unpacked (zstd): {error}") from error
    unpacked.seek(0)
    return unpacked
