"""Messages of a recording, read ahead by a thread of their own."""

import queue
import threading
from collections.abc import Iterator

from omm_recording.reading import RecordedMessage

AHEAD = 32


def read_ahead(
    messages: Iterator[RecordedMessage], ended: threading.Event
) -> Iterator[RecordedMessage]:
    """Read in a thread of its own, a little ahead, so that unpacking does not delay publishing."""
    waiting: queue.Queue[RecordedMessage | BaseException | None] = queue.Queue(AHEAD)
    left = threading.Event()

    def put(item: RecordedMessage | BaseException | None) -> bool:
        while not (left.is_set() or ended.is_set()):
            try:
                waiting.put(item, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False

    def read() -> None:
        try:
            for message in messages:
                if not put(message):
                    return
            put(None)
        except Exception as error:  # raised by who waits for the next message
            put(error)

    thread = threading.Thread(target=read, name="reading ahead")
    thread.start()
    try:
        while not ended.is_set():
            try:
                item = waiting.get(timeout=0.1)
            except queue.Empty:
                continue
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        left.set()
        thread.join()
