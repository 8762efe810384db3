"""One recording being written: its name, its lock, its attachments and its end.

While it is written it is called ``run.mcap.unfinished``; ``run.mcap`` appears when it is whole.
"""

import errno
import hashlib
import os
import shutil
import stat
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from omm_core.errors import OmmError
from omm_core.files.output import write_whole
from omm_recording.mcap_writer import McapWriter
from omm_recording.new_file import created, give_final_name, reserved, sync_folder
from omm_recording.rosbag2_format import (
    TopicCount,
    TopicQos,
    bag_metadata,
    channel_metadata,
    dumped,
)
from omm_recording.run_files import UNFINISHED
from omm_recording.seal import CHAIN, SEAL, chain_text, load_key, sealed

SYNC_PERIOD_S = 0.5
RUN_NAME = "run.mcap"
PROVENANCE = "omm_provenance"
REPORT = "omm_report"
FILE_SUMS = "omm_sha256"


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """How to record."""

    compression: str = "zstd"
    key_file: Path | None = None
    """Private key that signs the seal."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Who records with what: versions of everything."""
    distro: str = ""
    """Name of the ROS distribution."""


@dataclass(frozen=True, kw_only=True)
class TopicToRecord:
    """A topic, with what a reader needs to understand its messages."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    qos: TopicQos
    definition_encoding: str = "ros2msg"


class RecordingWriter:
    """Writes one recording. To be used by one thread.

    Parameters
    ----------
    path
        What it is called when it is whole: ``run.mcap`` in the run's folder.
    options
        How to record.
    unfinished
        What it is called until then; ``run.mcap.unfinished`` where not given.

    Raises
    ------
    InputError
        If there is a recording already, another recorder writes there, or the folder cannot be
        written.
    """

    def __init__(
        self, path: Path, options: RecordingOptions, unfinished: Path | None = None
    ) -> None:
        self.path = path
        self.unfinished = unfinished or path.with_name(path.name + UNFINISHED)
        self._options = options
        self._topics: dict[str, tuple[int, TopicToRecord]] = {}
        self._reserve: IO[bytes] | None = None
        if options.key_file is not None:
            load_key(options.key_file)  # a key that cannot sign is told now, not at the end
        self._file = created(self.path, self.unfinished)
        try:
            self._reserve = reserved(path.parent)
            self._writer = self._begun()
        except BaseException:
            if self._reserve is not None:
                self._reserve.close()
            self._file.close()
            self.unfinished.unlink()
            raise
        self._stop_syncing = threading.Event()
        self._sync_error: OSError | None = None
        self._syncing = threading.Thread(target=self._sync_now_and_then, daemon=True)
        self._syncing.start()

    @property
    def bytes_written(self) -> int:
        """Size of the file so far."""
        return self._writer.offset

    @property
    def folder_gone(self) -> bool:
        """Whether somebody removed the file that is being written."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    def counts(self) -> dict[str, int]:
        """Return the number of messages in the file so far, by topic."""
        counts = self._writer.contents.counts
        return {name: counts.get(channel, 0) for name, (channel, _) in self._topics.items()}

    def add_topic(self, topic: TopicToRecord) -> None:
        """Announce a topic, once, before its first message."""
        metadata = channel_metadata(topic.qos, topic.type_hash)
        channel = self._writer.add_channel(
            topic.name, topic.type_name, topic.definition, metadata, topic.definition_encoding
        )
        self._topics[topic.name] = (channel, topic)

    def add_file(self, name: str, data: bytes, time_ns: int) -> None:
        """Put a file into the recording, with its SHA-256."""
        kind = "application/yaml" if name.endswith((".yaml", ".yml")) else "text/plain"
        self._writer.add_attachment(name, kind, time_ns, data)
        sums = {name: hashlib.sha256(data).hexdigest()}
        self._writer.add_metadata(f"{FILE_SUMS} {name}", sums)

    def keep_as_private_as(self, mode: int) -> None:
        """Take from group and others what they may not do with a file of this mode."""
        own = stat.S_IMODE(os.fstat(self._file.fileno()).st_mode)
        os.fchmod(self._file.fileno(), own & (0o700 | mode))

    def add_table(self, name: str, values: dict[str, str]) -> None:
        """Put a named table into the recording."""
        self._writer.add_metadata(name, values)

    def fileno(self) -> int:
        """Return the open file."""
        return self._file.fileno()

    def write(
        self, topic: str, sequence: int, log_ns: int, publish_ns: int, data: bytes | memoryview
    ) -> None:
        """Write a message of a topic that was announced.

        Raises
        ------
        OSError
            If it cannot be written; the file stays sound.
        """
        if self._sync_error is not None:
            raise self._sync_error
        self._writer.add_message(self._topics[topic][0], sequence, log_ns, publish_ns, data)

    def flush(self) -> None:
        """Write what was gathered; to be called a few times a second."""
        self._writer.flush()

    def flush_at_end(self) -> None:
        """Write what was gathered if the disk has space for it; after this, `counts` is final.

        The space that was kept for the index is given free for it.
        """
        self._release_reserve()
        try:
            self._writer.flush()
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            self._writer.drop_pending()

    def abandon(self) -> None:
        """Give up and leave nothing behind."""
        self._stop()
        self._file.close()
        self.unfinished.unlink(missing_ok=True)

    def _stop(self) -> None:
        self._stop_syncing.set()
        self._syncing.join()
        self._release_reserve()

    def _release_reserve(self) -> None:
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None

    def close(self, report: dict[str, str]) -> Path:
        """End the recording and give it its name.

        Parameters
        ----------
        report
            What became of the messages, kept as metadata.

        Raises
        ------
        OmmError
            If there is no space or no disk to end it; what was written stays under its
            unfinished name.
        """
        self._stop()
        try:
            metadata = self._end(report)
            os.fdatasync(self._file.fileno())
            if self.folder_gone:
                self._rescue()
            else:
                give_final_name(self.unfinished, self.path)
            if self.path.name == RUN_NAME:  # rosbag2 wants one recording in a folder
                write_whole(self.path.with_name("metadata.yaml"), metadata)
                sync_folder(self.path.parent)
        except OSError as error:
            raise OmmError(
                f"The recording could not be ended: {error.strerror}. What was written so far "
                f"stays in {self.unfinished}; make space, then: ./omm repair {self.unfinished}"
            ) from error
        finally:
            self._file.close()
        return self.path

    def _end(self, report: dict[str, str]) -> str:
        self.flush_at_end()
        contents = self._writer.contents
        counts = self.counts()
        topics = [
            TopicCount(
                name=topic.name,
                type_name=topic.type_name,
                type_hash=topic.type_hash,
                qos=topic.qos,
                messages=counts[topic.name],
            )
            for _, topic in self._topics.values()
        ]
        start = contents.first_ns or 0
        duration = contents.last_ns - start
        bag = bag_metadata(self.path.name, topics, start, duration, self._options.distro)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": dumped(bag)})
        if report:
            self._writer.add_metadata(REPORT, report)
        links = list(self._writer.links)
        self._writer.add_attachment(CHAIN, "text/csv", time.time_ns(), chain_text(links))
        self._writer.add_metadata(SEAL, sealed(links, self._options.key_file))
        self._writer.finish()
        return dumped({"rosbag2_bagfile_information": bag})

    def _rescue(self) -> None:
        """Copy the data into the folder again: it was removed.

        They are there as long as the file is open.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        written = Path(f"/proc/self/fd/{self._file.fileno()}")
        with written.open("rb") as source, self.unfinished.open("xb") as copy:
            os.fchmod(copy.fileno(), stat.S_IMODE(os.fstat(self._file.fileno()).st_mode))
            shutil.copyfileobj(source, copy, 8 << 20)
            copy.flush()
            os.fdatasync(copy.fileno())
        give_final_name(self.unfinished, self.path)

    def _begun(self) -> McapWriter:
        """Write what is known at the start."""
        options = self._options
        library = f"omm {options.provenance.get('omm', '')}".strip()
        writer = McapWriter(self._file, compression=options.compression, library=library)
        writer.add_metadata(PROVENANCE, options.provenance)
        return writer

    def _sync_now_and_then(self) -> None:
        """Sync to the disk now and then: a power cut then loses less than a second."""
        synced = 0
        while not self._stop_syncing.wait(SYNC_PERIOD_S):
            offset = self._writer.offset
            if offset == synced:
                continue
            try:
                os.fdatasync(self._file.fileno())
            except OSError as error:
                self._sync_error = error
                return
            synced = offset
