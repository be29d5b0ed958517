"""Storage of ROS 2 bags: the messages of an MCAP or SQLite (.db3) file, compressed or not.

rosbag2 compresses by zstd: whole files (name.mcap.zstd, name.db3.zstd) or each message; MCAP compresses chunks. librealsense
compresses each message of a .db3, too. A file that was cut, for example by a loss of power, is read up to the cut.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uav_recon.sensors.recordings.recording import RecordingError

MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\x00"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
ROS1_MAGIC = b"#ROSBAG V2.0"
SUFFIXES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
_QUERY = (
    "SELECT topics.name, topics.type, messages.timestamp, messages.data FROM messages JOIN topics "
    "ON topics.id = messages.topic_id ORDER BY messages.timestamp, messages.id"
)


@dataclass(frozen=True)
class RawMessage:
    """A message of a bag: topic, type, its instant in the file, and CDR bytes."""

    topic: str
    kind: str
    file_ns: int
    data: bytes

    def stamp_s(self) -> float:
        """Return the stamp of its header, which comes first in every type with a header."""
        seconds, nanoseconds = struct.unpack_from("<iI" if self.data[1] & 1 else ">iI", self.data, 4)
        return float(seconds + nanoseconds * 1e-9)


class BagStorage:
    """A file of a bag. path: what errors name.

    A file that is compressed as a whole is decompressed into a temporary folder, which is removed with this object. ``cut``:
    True after a pass over a file that ends before its end. Raises RecordingError and OSError.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.cut = path, False
        self._content = path
        if _head(path).startswith(ZSTD_MAGIC):
            folder = Path(tempfile.mkdtemp(prefix="uav_recon_bag_"))
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            self._content = folder / path.name.removesuffix(".zstd")
            self._decompress(path, self._content)
        head = _head(self._content)
        self.sqlite, self.ros1 = head == SQLITE_MAGIC, head.startswith(ROS1_MAGIC)
        if not (self.sqlite or self.ros1 or head.startswith(MCAP_MAGIC)):
            raise RecordingError(f"{path}: is compressed by zstd, and holds no bag: it begins with {head[:8]!r}")

    @property
    def content(self) -> Path:
        """The file without compression."""
        return self._content

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of the file, each without compression."""
        self.cut = False
        for message in self._sqlite_messages() if self.sqlite else self._mcap_messages():
            if message.data.startswith(ZSTD_MAGIC):
                yield RawMessage(message.topic, message.kind, message.file_ns, _decompressed(message.data))
            else:
                yield message

    def topics(self) -> list[tuple[str, str]]:
        """Return name and type of the topics of an SQLite file.

        Empty if it is damaged or another file.
        """
        if not self.sqlite:
            return []
        with closing(read_only(self._content)) as database:
            try:
                return database.execute("SELECT name, type FROM topics").fetchall()
            except sqlite3.DatabaseError:
                return []

    def _decompress(self, source: Path, target: Path) -> None:
        zstandard = _zstandard()
        with source.open("rb") as compressed, target.open("wb") as out:
            try:
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(compressed, read_across_frames=True), out)
            except zstandard.ZstdError as error:
                raise RecordingError(f"{source}: damaged or cut ({error})") from None

    def _mcap_messages(self) -> Iterator[RawMessage]:
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader

        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        with self._content.open("rb") as stream:
            try:
                for record in StreamReader(stream).records:
                    if isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        channels[record.id] = record
                    elif isinstance(record, Message):
                        channel = channels[record.channel_id]
                        if channel.message_encoding == "cdr":
                            kind = schemas[channel.schema_id].name
                            yield RawMessage(channel.topic, kind, record.log_time, record.data)
            except (McapError, struct.error, ValueError, EOFError):
                self.cut = True

    def _sqlite_messages(self) -> Iterator[RawMessage]:
        read = False
        with closing(read_only(self._content)) as database:
            try:
                for row in database.execute(_QUERY):
                    read = True
                    yield RawMessage(*row)
            except sqlite3.OperationalError as error:
                raise RecordingError(f"{self.path}: an SQLite file, but no ROS 2 bag ({error})") from None
            except sqlite3.DatabaseError as error:
                if not read:
                    raise RecordingError(f"{self.path}: damaged or cut ({error})") from None
                self.cut = True


def bag_file(path: Path) -> Path | None:
    """Return the bag at a path, or the only one in a folder; None if there is none.

    Raises RecordingError for several.
    """
    if path.is_dir():
        files = [entry for entry in sorted(path.iterdir()) if entry.name.endswith(SUFFIXES)]
        if len(files) > 1:
            names = ", ".join(file.name for file in files[:3])
            raise RecordingError(f"{path}: a bag of several files ({names}); name one of them, or merge them: ros2 bag convert")
        return files[0] if files else None
    head = _head(path)
    return path if head == SQLITE_MAGIC or head.startswith((MCAP_MAGIC, ROS1_MAGIC, ZSTD_MAGIC)) else None


def read_only(file: Path) -> sqlite3.Connection:
    """Open an SQLite file for reading. Raises sqlite3.Error."""
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(SQLITE_MAGIC))


def _decompressed(data: bytes) -> bytes:
    """Return a message that zstd has compressed; its frame may not tell the size."""
    return bytes(_zstandard().ZstdDecompressor().decompressobj().decompress(data))


def _zstandard() -> Any:
    """Return the package zstandard, which mcap needs, too. Raises RecordingError without it."""
    try:
        import zstandard
    except ImportError:
        raise RecordingError("a compressed bag needs the package zstandard: pip install 'uav-recon[recordings]'") from None
    return zstandard
