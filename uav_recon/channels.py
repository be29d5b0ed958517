"""Last-value channels: in memory for lockstep, memory-mapped files between processes.

A file has a head and one record. The head holds the format, a hash of the layout, a sequence number and a CRC; the record is a
JSON head and raw array bytes. There is no pickle: a hostile writer can at most cause rejected records. A reader copies once and
then checks the sequence number again. It rejects records of another layout, which another build has written.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import logging
import math
import mmap
import os
import struct
import types
import typing
import zlib
from collections.abc import Callable, Hashable
from enum import Enum
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

T = TypeVar("T")
LOG = logging.getLogger(__name__)

MODE = 0o640  # the group may read
_HEAD = struct.Struct("<8s8sqIIq")  # format, layout, sequence, length, CRC, sequence again
_FORMAT = b"UAVCHAN2"
_EMPTY = bytes(8)  # in place of the format, in a file without a writer
_UNFINISHED = -1  # in place of the second sequence number, while a record is written
_DECODE_ERRORS = (struct.error, TypeError, IndexError, KeyError, AttributeError, OverflowError, RecursionError, SyntaxError)
_UNIONS = (types.UnionType, typing.Union)
_PLAIN = {float, int, str, bool, type(None)}  # JSON's own types

Encoder = Callable[[Any, list[np.ndarray[Any, Any]]], Any]  # (value, list that receives its arrays) to a tree of JSON's types
Decoder = Callable[[Any, list[np.ndarray[Any, Any]]], Any]  # (tree of JSON's types, arrays) to a value


class ChannelError(Exception):
    """Raised for a channel of another build; the text is one line.

    It names the channel, the layout that was found and the one that is wanted.
    """


class MemoryChannel(Generic[T]):
    """A channel for lockstep. Values pass through encode() and decode(), as in a FileChannel."""

    def __init__(self, kind: type[T]) -> None:
        self._kind = kind
        self._value = cast("T | None", None)
        self._sequence = 0

    def publish(self, value: T) -> None:
        """Replace the value."""
        self._value = decode(encode(value), self._kind)
        self._sequence += 1

    def latest(self) -> T | None:
        """Return the newest value, or None."""
        return self._value

    def sequence(self) -> int:
        """Return the number of values published."""
        return self._sequence


class _MappedChannel(Generic[T]):
    """The reading side of a channel in a memory-mapped file."""

    def __init__(self, path: Path, kind: type[T], capacity_bytes: int) -> None:
        self._path = path
        self._kind = kind
        self._size = capacity_bytes + _HEAD.size
        self._layout = layout_hash(kind, capacity_bytes)
        self._map: mmap.mmap | None = None
        self._read_sequence = -1
        self._value = cast("T | None", None)
        self._logged = ""

    def latest(self) -> T | None:
        """Return the newest value; for a torn, invalid or foreign record, return the previous value.

        A file of another layout is logged once.
        """
        data = self._new_record()
        if data is not None:
            try:
                self._value = decode(data, self._kind)
            except ValueError:  # from a hostile writer: reject the record once
                return self._value
        return self._value

    def sequence(self) -> int:
        """Return the number of values published."""
        head = self._head()
        return 0 if head is None or head[:2] != (_FORMAT, self._layout) else int(head[2])

    def check(self) -> None:
        """Check the layout of the file. Raises ChannelError if another build has written it.

        A file that does not exist yet, or has no writer yet, is no error.
        """
        fault = self._fault(self._head())
        if fault:
            raise ChannelError(fault)

    def _head(self) -> tuple[Any, ...] | None:
        return None if self._map is None else _HEAD.unpack(self._map[: _HEAD.size])

    def _new_record(self) -> bytes | None:
        """Return the bytes of a record that was not read before, None without one."""
        head = self._head()
        fault = self._fault(head)
        if fault:
            self._log_once(fault)
        if fault or head is None or self._map is None:
            return None
        _, _, sequence, length, crc, sequence_end = head
        if sequence == self._read_sequence or sequence != sequence_end or length > len(self._map) - _HEAD.size:
            return None
        data = self._map[_HEAD.size : _HEAD.size + length]
        if zlib.crc32(data) != crc:
            return None
        self._read_sequence = sequence
        return data

    def _fault(self, head: tuple[Any, ...] | None) -> str:
        """Return how a head differs from ours in one line, '' if it does not."""
        if head is None or head[0] == _EMPTY or head[:2] == (_FORMAT, self._layout):
            return ""
        found = f"layout {head[1].hex()}" if head[0] == _FORMAT else f"format {head[0]!r}"
        wanted = f"layout {self._layout.hex()} in format {_FORMAT!r}"
        return f"{self._path}: written by another build: {found}, want {wanted}"

    def _log_once(self, fault: str) -> None:
        if fault != self._logged:
            LOG.error("%s", fault)
        self._logged = fault


class FileChannel(_MappedChannel[T]):
    """A channel in a memory-mapped file, opened by its only writer.

    Its readers are ReadOnlyFileChannels in any number, of the same user or group. The file survives a crash of either side.
    """

    def __init__(self, path: Path, kind: type[T], capacity_bytes: int = 1 << 16) -> None:
        """Create the file if needed; a file of another layout is emptied. Raises OSError."""
        super().__init__(path, kind, capacity_bytes)
        self._own = _map_to_write(path, self._size)
        self._map = self._own
        before = _HEAD.unpack(self._own[: _HEAD.size])
        if before[:2] != (_FORMAT, self._layout):
            sequence = before[2] if before[0] == _FORMAT else 0
            self._own[: _HEAD.size] = _HEAD.pack(_FORMAT, self._layout, sequence, 0, 0, _UNFINISHED)

    def publish(self, value: T) -> None:
        """Replace the value. Raises ValueError if it exceeds the capacity."""
        data = encode(value)
        if len(data) + _HEAD.size > self._size:
            raise ValueError(f"{self._path.name}: {len(data)} bytes do not fit in {self._size - _HEAD.size}")
        sequence = self.sequence() + 1
        head = (_FORMAT, self._layout, sequence, len(data), zlib.crc32(data))
        self._own[: _HEAD.size] = _HEAD.pack(*head, _UNFINISHED)
        self._own[_HEAD.size : _HEAD.size + len(data)] = data
        self._own[: _HEAD.size] = _HEAD.pack(*head, sequence)


class ReadOnlyFileChannel(_MappedChannel[T]):
    """A channel in a memory-mapped file, opened read-only.

    It cannot change the file or block the writer. The file may be created later; until then there is no value.
    """

    def __init__(self, path: Path, kind: type[T], capacity_bytes: int = 1 << 16) -> None:
        """Open the file if it exists. Raises OSError if this user may not read it."""
        super().__init__(path, kind, capacity_bytes)
        self._map = _map_to_read(path, self._size)

    def publish(self, value: T) -> None:
        """Raise PermissionError: only the writer publishes."""
        raise PermissionError(f"{self._path}: opened read-only")

    def _head(self) -> tuple[Any, ...] | None:
        if self._map is None or len(self._map) < self._size:
            try:
                self._map = _map_to_read(self._path, self._size)
            except OSError as error:
                self._log_once(f"{self._path}: cannot be read ({error.strerror})")
        return super()._head()


def create_file(path: Path, capacity_bytes: int = 1 << 16) -> None:
    """Create the file of a channel if needed, readable for the group with any umask.

    Raises OSError.
    """
    os.close(_open_to_write(path, capacity_bytes + _HEAD.size))


def _open_to_write(path: Path, size: int) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, MODE)
    try:
        os.fchmod(descriptor, MODE)
        if os.fstat(descriptor).st_size < size:
            os.ftruncate(descriptor, size)  # it never shrinks: a reader may have mapped it
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _map_to_write(path: Path, size: int) -> mmap.mmap:
    descriptor = _open_to_write(path, size)
    try:
        return mmap.mmap(descriptor, size)
    finally:
        os.close(descriptor)


def _map_to_read(path: Path, size: int) -> mmap.mmap | None:
    """Map at most ``size`` bytes of a file; return None if there is no file or no head yet."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)  # does not wait at a FIFO
    except FileNotFoundError:
        return None
    try:
        there = min(os.fstat(descriptor).st_size, size)
        return None if there < _HEAD.size else mmap.mmap(descriptor, there, access=mmap.ACCESS_READ)
    finally:
        os.close(descriptor)


def layout_hash(kind: Any, capacity_bytes: int) -> bytes:
    """Return a hash (8 bytes) of what a reader relies on.

    These are the names (which contain the units), order and types of all fields, the values of enums, and the capacity.
    """
    return hashlib.sha256(f"{capacity_bytes} {_layout(kind, ())}".encode()).digest()[:8]


def _layout(kind: Any, outer: tuple[Any, ...]) -> str:
    """Return a type as text; outer: the dataclasses around it, for a type that contains itself."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is np.ndarray:
        return f"array[{np.dtype(typing.get_args(arguments[1])[0]).str}]"
    if origin is not None:
        name = "union" if origin in _UNIONS else origin.__name__
        return f"{name}[{','.join('...' if a is Ellipsis else _layout(a, outer) for a in arguments)}]"
    parts = []
    if issubclass(kind, Enum):
        parts = [repr(member.value) for member in kind]
    elif dataclasses.is_dataclass(kind) and kind not in outer:
        parts = [f"{name}:{_layout(hint, (*outer, kind))}" for name, hint in _fields(cast("type", kind))]
    return f"{kind.__name__}({','.join(parts)})"


def encode(value: Any) -> bytes:
    """Encode a tree of frozen dataclasses, numbers, strings, enums, tuples and arrays as bytes."""
    arrays: list[np.ndarray[Any, Any]] = []
    head = json.dumps(_encode(value, arrays)).encode()
    parts = [struct.pack("<I", len(head)), head]
    for array in arrays:
        shape = struct.pack(f"<B{array.ndim}I", array.ndim, *array.shape)
        kind = array.dtype.str.encode()
        parts += [struct.pack("<B", len(kind)), kind, shape, array.tobytes()]
    return b"".join(parts)


@functools.cache
def _encoder(kind: type) -> Encoder:
    """Return the function that turns values of a class into JSON's types."""
    if issubclass(kind, np.ndarray):
        return _encode_array
    if issubclass(kind, Enum):
        return lambda value, _: value.value
    if dataclasses.is_dataclass(kind):
        names = [field.name for field in dataclasses.fields(kind)]
        return lambda value, arrays: [_encode(getattr(value, name), arrays) for name in names]
    if issubclass(kind, tuple):
        return lambda value, arrays: [_encode(item, arrays) for item in value]
    if issubclass(kind, np.generic):
        return lambda value, _: value.item()
    return lambda value, _: value


def _encode(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    kind = type(value)
    return value if kind in _PLAIN else _encoder(cast("Hashable", kind))(value, arrays)


def _encode_array(value: np.ndarray[Any, Any], arrays: list[np.ndarray[Any, Any]]) -> int:
    arrays.append(value)
    return len(arrays) - 1


def decode(data: bytes, kind: type[T]) -> T:
    """Decode the bytes of encode() by the declared types.

    Raises ValueError on bytes that do not fit.
    """
    try:
        (length,) = struct.unpack_from("<I", data)
        tree = json.loads(data[4 : 4 + length])
        arrays = _read_arrays(data, 4 + length)
        return cast("T", _decoder(cast("Hashable", kind))(tree, arrays))
    except (*_DECODE_ERRORS, UnicodeDecodeError) as error:
        raise ValueError(f"not a {kind.__name__}: {error}") from None


def _read_arrays(data: bytes, offset: int) -> list[np.ndarray[Any, Any]]:
    arrays = []
    while offset < len(data):
        kind_length = data[offset]
        dtype = np.dtype(data[offset + 1 : offset + 1 + kind_length].decode())
        if dtype.hasobject:
            raise ValueError("object arrays are not carried")
        offset += 1 + kind_length
        dimensions = data[offset]
        shape = struct.unpack_from(f"<{dimensions}I", data, offset + 1)
        offset += 1 + 4 * dimensions
        array = np.frombuffer(data, dtype, math.prod(shape), offset).reshape(shape)
        array.setflags(write=False)
        arrays.append(array)
        offset += array.nbytes
    return arrays


@functools.cache
def _fields(kind: type) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(kind)
    return [(f.name, hints[f.name]) for f in dataclasses.fields(kind)]


@functools.cache
def _decoder(kind: Any) -> Decoder:
    """Return the function that makes a value of a declared type."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is np.ndarray:
        return lambda tree, arrays: arrays[tree]
    if origin in _UNIONS:
        return _union_decoder([argument for argument in arguments if argument is not type(None)])
    if origin is tuple:
        return _tuple_decoder(arguments)
    if dataclasses.is_dataclass(kind):
        return functools.partial(_decode_dataclass, cast("type", kind))
    return lambda tree, _: kind(tree)  # a number, text or an enum


def _union_decoder(kinds: list[Any]) -> Decoder:
    """Return the function for one type or None, or for several types that JSON distinguishes.

    These are numbers and text.
    """

    def decode_one(tree: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
        return None if tree is None else _decoder(kinds[0])(tree, arrays)

    def check(tree: Any, _: list[np.ndarray[Any, Any]]) -> Any:
        if tree is not None and type(tree) not in kinds:
            raise ValueError(f"{type(tree).__name__} is none of {kinds}")
        return tree

    return decode_one if len(kinds) == 1 else check


def _tuple_decoder(kinds: tuple[Any, ...]) -> Decoder:
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        item = _decoder(kinds[0])
        return lambda tree, arrays: tuple(item(part, arrays) for part in tree)
    items = [_decoder(kind) for kind in kinds]
    return lambda tree, arrays: tuple(item(part, arrays) for item, part in zip(items, tree, strict=True))


def _decode_dataclass(kind: type, tree: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    decoders = _field_decoders(kind)
    if len(decoders) != len(tree):
        raise ValueError(f"{kind} has {len(decoders)} fields, got {len(tree)}")
    return kind(**{name: item(part, arrays) for (name, item), part in zip(decoders, tree, strict=True)})


@functools.cache
def _field_decoders(kind: type) -> list[tuple[str, Decoder]]:
    return [(name, _decoder(hint)) for name, hint in _fields(kind)]
