"""Reading by the checksum chain: what omm recorded is believed block by block, as it is read.

`verify` compares the whole file; this compares each block that decides a result, when it is read,
with its link of the chain (see `seal`). The index says where the blocks are: it must name just
those that the chain has.
"""

from __future__ import annotations

import bisect
import hashlib
from collections.abc import Iterable
from typing import IO

from mcap.opcode import Opcode

from omm_recording.container import PREFIX, Damaged
from omm_recording.mcap_writer import Link

_LARGEST_BLOCK = 1 << 32
_PIECE_BYTES = 8 << 20


class Chain:
    """The links of a recording, and which of them were found to hold.

    Parameters
    ----------
    file
        The recording.
    links
        In the order of their offsets, as `seal.parsed_chain` reads them.
    """

    def __init__(self, file: IO[bytes], links: list[Link]) -> None:
        self._file = file
        self._links = links
        self._offsets = [link.offset for link in links]
        self._good: set[int] = set()

    @property
    def end(self) -> int:
        """Where the chained part of the file ends; after it come chain, seal and index."""
        return self._links[-1].offset + self._links[-1].length if self._links else 0

    def begins_well(self) -> bool:
        """Return whether the file begins as it was sealed; a rewritten one does not."""
        return bool(self._links) and self._links[0].offset == 0 and self._holds(0)

    def check(self, offset: int) -> None:
        """Make sure that the block at an offset is as it was recorded.

        Raises
        ------
        Damaged
            If not, or if the chain has no block there.
        """
        number = bisect.bisect_left(self._offsets, offset)
        if number == len(self._offsets) or self._offsets[number] != offset:
            raise Damaged(f"the block at byte {offset} is not one that was sealed")
        if not self._holds(number):
            raise Damaged(f"the block at byte {offset} has another checksum than was written")

    def check_index(self, opcode: int, offsets: Iterable[int]) -> None:
        """Make sure that an index names all blocks of a kind that were sealed, and no others.

        Raises
        ------
        Damaged
            If not.
        """
        named = sorted(offset for offset in offsets if offset < self.end)
        if named != self.blocks(opcode):
            raise Damaged(f"the index does not name the {Opcode(opcode).name.lower()}s that it has")

    def blocks(self, opcode: int) -> list[int]:
        """Return the offsets of the blocks that begin with a record of a kind."""
        return [offset for offset in self._offsets if offset and self._opcode(offset) == opcode]

    def _opcode(self, offset: int) -> int:
        self._file.seek(offset)
        prefix = self._file.read(PREFIX.size)
        return int(PREFIX.unpack(prefix)[0]) if len(prefix) == PREFIX.size else -1

    def _holds(self, number: int) -> bool:
        if number in self._good:
            return True
        link = self._links[number]
        before = bytes.fromhex(self._links[number - 1].sha256) if number else b""
        digest = hashlib.sha256(before)
        self._file.seek(link.offset)
        left = min(link.length, _LARGEST_BLOCK)
        while left > 0 and (piece := self._file.read(min(left, _PIECE_BYTES))):
            digest.update(piece)
            left -= len(piece)
        if left or digest.hexdigest() != link.sha256:
            return False
        self._good.add(number)
        return True
