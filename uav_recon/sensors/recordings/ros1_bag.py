"""Messages of a ROS 1 bag (format 2.0), in the order of the file.

The file is read from its begin and not by the index at its end: a recorder that was killed writes no index. Format:
http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from uav_recon.sensors.recordings.bag_storage import RawMessage
from uav_recon.sensors.recordings.recording import RecordingError

_MESSAGE, _BAG, _CHUNK, _CONNECTION = 2, 3, 5, 7  # the record types that are read


@dataclass(frozen=True)
class _Record:
    """A record: the fields of its header, and its data."""

    fields: dict[str, bytes]
    data: bytes

    @property
    def kind(self) -> int:
        return self.fields.get("op", b"\0")[0]

    def number(self, name: str) -> int:
        return int.from_bytes(self.fields[name], "little")


class Ros1Bag:
    """The messages of a file.

    ``cut``: True after a pass over a file that was not closed, or ends before its end.
    """

    def __init__(self, file: Path) -> None:
        self._file, self.cut = file, False

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages; RawMessage.data is that of ROS 1.

        Raises OSError, and RecordingError for unknown compression.
        """
        self.cut = False
        topics: dict[int, tuple[str, str]] = {}
        with self._file.open("rb") as stream:
            stream.readline()  # the magic bytes
            for record in self._records(stream):
                if record.kind == _CONNECTION:
                    topics[record.number("conn")] = _connection(record)
                elif record.kind == _MESSAGE and record.number("conn") in topics:
                    seconds, nanoseconds = struct.unpack("<II", record.fields["time"])
                    topic, kind = topics[record.number("conn")]
                    yield RawMessage(topic, kind, seconds * 10**9 + nanoseconds, record.data)

    def _records(self, stream: BinaryIO) -> Iterator[_Record]:
        """Yield the records, those inside chunks, too."""
        while (record := self._record(stream)) is not None:
            if record.kind == _CHUNK:
                inside = self._uncompressed(record)
                while inside is not None and (one := self._record(inside)) is not None:
                    yield one
            else:
                self.cut |= record.kind == _BAG and record.number("index_pos") == 0
                yield record

    def _record(self, stream: BinaryIO) -> _Record | None:
        """Return the next record; None at the end of the stream, or at a cut."""
        head = stream.read(4)
        if not head:
            return None
        header = _sized(stream, head)
        data = None if header is None else _sized(stream, stream.read(4))
        fields = None if header is None else _fields(header)
        if data is None or fields is None:
            self.cut = True
            return None
        return _Record(fields, data)

    def _uncompressed(self, chunk: _Record) -> BytesIO | None:
        """Return the content of a chunk, None if it is damaged."""
        kind = chunk.fields.get("compression", b"none").decode(errors="replace")
        if kind not in _DECOMPRESS:
            raise RecordingError(f"{self._file}: compression {kind!r}; want one of {', '.join(_DECOMPRESS)}")
        try:
            return BytesIO(_DECOMPRESS[kind](chunk.data))
        except (RuntimeError, ValueError, OSError, EOFError):
            self.cut = True
            return None


def _sized(stream: BinaryIO, size: bytes) -> bytes | None:
    """Return as many bytes as these four tell; None if the stream has fewer."""
    if len(size) < 4:
        return None
    (count,) = struct.unpack("<I", size)
    data = stream.read(count)
    return data if len(data) == count else None


def _fields(header: bytes) -> dict[str, bytes] | None:
    """Return the fields `name=value` of a header, None if it is none."""
    fields, at = {}, 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, equals, value = header[at + 4 : at + 4 + size].partition(b"=")
        if not equals:
            return None
        fields[name.decode(errors="replace")] = value
        at += 4 + size
    return fields if at == len(header) else None


def _connection(record: _Record) -> tuple[str, str]:
    """Return topic and type of a connection; the type has the name that ROS 2 gives it."""
    topic = record.fields["topic"].decode(errors="replace")
    kind = (_fields(record.data) or {}).get("type", b"").decode(errors="replace")
    package, _, name = kind.rpartition("/")
    return "/" + "/".join(part for part in topic.split("/") if part), f"{package}/msg/{name}"


def _lz4(data: bytes) -> bytes:
    from lz4.frame import decompress

    return bytes(decompress(data))


_DECOMPRESS: dict[str, Callable[[bytes], bytes]] = {"none": bytes, "lz4": _lz4, "bz2": bz2.decompress}
