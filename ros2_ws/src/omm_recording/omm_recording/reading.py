"""Recordings read without ROS: whoever wrote them, in one file or several, compressed or not."""

import hashlib
import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from omm_core.errors import InputError
from omm_recording.container import LARGEST_CHUNK, unzstd
from omm_recording.decoding import decoder
from omm_recording.mcap_file import Attached, Block, McapFile
from omm_recording.run_files import RunFiles, find_run, open_recording
from omm_recording.writing import FILE_SUMS

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class RecordedMessage(NamedTuple):
    """One message as it was recorded. A tuple: there are many of them."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: memoryview
    """Serialised (CDR)."""


# Compressed images have lost what their codec found unimportant: that decides a dot's centre.
_ADVICE = {
    "sensor_msgs/msg/CompressedImage": " Record the raw images beside them and name their topic "
    "(--image-topic); a lossless recording can be unpacked with image_transport's republish."
}


@dataclass(frozen=True, kw_only=True)
class Topic:
    """What the recording says of one topic."""

    name: str
    type_name: str
    encoding: str
    definition_encoding: str
    definition: str
    metadata: dict[str, str]
    messages: int | None
    """None where the file does not count them."""


class Recording:
    """A recording, open for reading; use it in a ``with`` statement.

    Parameters
    ----------
    run
        An MCAP file, a folder with ``run.mcap``, or a folder that rosbag2 made.

    Raises
    ------
    InputError
        If it is not a recording, or was cut short.
    """

    def __init__(self, run: Path) -> None:
        self.run: RunFiles = find_run(run)
        self._stack = ExitStack()
        try:
            self.files = tuple(self._opened(path) for path in self.run.recordings)
        except BaseException:
            self._stack.close()
            raise
        self.topics = _joined(self.files)
        self._decoders: dict[str, Callable[[Any], Any]] = {}

    def _opened(self, path: Path) -> McapFile:
        return McapFile(path, self._stack.enter_context(open_recording(path)))

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def require(self, topic: str, type_name: str) -> None:
        """Make sure that a topic is there, has the type and at least one message.

        Raises
        ------
        InputError
            If not; the message tells what is there.
        """
        found = self.topics.get(topic)
        if found is None or found.messages == 0:
            there = (
                ", ".join(f"{t.name} ({t.type_name})" for t in self.topics.values()) or "nothing"
            )
            raise InputError(
                f"Expected messages on {topic} ({type_name}) in {self.run.recordings[0]}, "
                f"got none. It holds: {there}."
            )
        if found.type_name != type_name:
            advice = _ADVICE.get(found.type_name, "")
            got = found.type_name or "messages of no type (the file holds no schema for them)"
            raise InputError(f"Expected {type_name} on {topic}, got {got}.{advice}")

    def messages(
        self,
        topics: Collection[str] | None = None,
        *,
        start_ns: int = 0,
        end_ns: int | None = None,
    ) -> Iterator[RecordedMessage]:
        """Yield the messages in the order of their log times; equal times in the order of writing.

        Parameters
        ----------
        topics
            Which; all where None.
        start_ns, end_ns
            Log times from `start_ns` on and before `end_ns`. What lies outside is not read.

        Raises
        ------
        InputError
            Where a part of the file is damaged.
        """
        end = 2**64 if end_ns is None else end_ns
        blocks: list[tuple[int, int, McapFile, Block]] = []
        for file in self.files:
            for block in file.blocks(topics):
                if block.last_ns >= start_ns and block.first_ns < end:
                    blocks.append((block.first_ns, len(blocks), file, block))
        blocks.sort(key=lambda item: item[:2])
        waiting: list[tuple[int, int, RecordedMessage]] = []
        count = 0
        read: Counter[tuple[int, int]] = Counter()
        for first_ns, _, file, block in blocks:
            while waiting and waiting[0][0] < first_ns:
                yield heapq.heappop(waiting)[2]
            for channel_id, sequence, log_ns, publish_ns, data in file.messages_in(block):
                channel = file.channels.get(channel_id)
                if channel is None:
                    raise InputError(
                        f"{file.path} is damaged: it has a message of channel {channel_id}, which "
                        f"it does not describe. Try ./omm repair {file.path}"
                    )
                read[id(file), channel_id] += 1
                if (
                    topics is not None and channel.name not in topics
                ) or not start_ns <= log_ns < end:
                    continue
                message = RecordedMessage(
                    channel.name, channel.type_name, log_ns, publish_ns, sequence, _plain(data)
                )
                heapq.heappush(waiting, (log_ns, count, message))
                count += 1
        if start_ns <= 0 and end_ns is None:
            self._compare_counts(read, topics)
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _compare_counts(
        self, read: Counter[tuple[int, int]], topics: Collection[str] | None
    ) -> None:
        """Make sure that as many messages were read as the writer says that it wrote."""
        for file in self.files:
            for channel_id, channel in file.channels.items():
                if file.counts is None or (topics is not None and channel.name not in topics):
                    continue
                written, got = file.counts.get(channel_id, 0), read[id(file), channel_id]
                if written != got:
                    raise InputError(
                        f"{file.path} is damaged: {written} messages were written on "
                        f"{channel.name}, {got} are found. Try ./omm repair {file.path}"
                    )

    def decode(self, message: RecordedMessage) -> Any:
        """Turn a message's bytes into an object with the fields of its type."""
        decode = self._decoders.get(message.topic)
        if decode is None:
            topic = self.topics[message.topic]
            if topic.encoding != "cdr":
                raise InputError(
                    f"Expected ROS 2 messages (cdr) on {topic.name}, got {topic.encoding!r}. "
                    "Convert the recording first, for instance with rosbags-convert."
                )
            decode = decoder(topic.type_name, topic.definition_encoding, topic.definition)
            self._decoders[message.topic] = decode
        return decode(message.data)

    def attachments(self) -> list[Attached]:
        """Return the files inside the recording."""
        return [attached for file in self.files for attached in file.attachments()]

    def attachment(self, name: str) -> bytes | None:
        """Return the newest file of that name inside the recording.

        Raises
        ------
        InputError
            Where it is not the file whose SHA-256 was recorded with it.
        """
        found = [attached for attached in self.attachments() if attached.name == name]
        if not found:
            return None
        data = found[-1].data
        told = self.metadata().get(f"{FILE_SUMS} {name}", {}).get(name)
        if told is not None and told != hashlib.sha256(data).hexdigest():
            raise InputError(
                f"{self.run.recordings[0]}: the file {name!r} inside it is not the one that was"
                " recorded (its SHA-256 differs). Name another one on the command line."
            )
        return data

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records, by their names."""
        return {name: values for file in self.files for name, values in file.metadata().items()}


def _plain(data: memoryview) -> memoryview:
    if data[:4] != ZSTD_MAGIC:  # rosbag2's compression by message; CDR begins with 0
        return data
    import zstandard

    try:
        plain = unzstd(data, LARGEST_CHUNK)
    except (zstandard.ZstdError, MemoryError) as error:
        raise InputError(f"A message is compressed with zstd and damaged: {error}") from error
    if len(plain) > LARGEST_CHUNK:
        raise InputError(f"A message unpacks to more than {LARGEST_CHUNK >> 20} MB.")
    return memoryview(plain)


def _joined(files: tuple[McapFile, ...]) -> dict[str, Topic]:
    """Return the topics of all files, with their messages counted together."""
    topics: dict[str, Topic] = {}
    for file in files:
        for identifier, channel in file.channels.items():
            counted = file.counts.get(identifier, 0) if file.counts is not None else None
            before = topics.get(channel.name)
            if before is not None:
                if before.type_name != channel.type_name:
                    raise InputError(
                        f"{file.path} holds two types on {channel.name}: {before.type_name} and "
                        f"{channel.type_name}."
                    )
                counted = (
                    None
                    if counted is None or before.messages is None
                    else counted + before.messages
                )
            topics[channel.name] = Topic(
                name=channel.name,
                type_name=channel.type_name,
                encoding=channel.encoding,
                definition_encoding=channel.definition_encoding,
                definition=channel.definition,
                metadata=channel.metadata,
                messages=counted,
            )
    return topics
