"""Last-value channels: in memory for lockstep, memory-mapped files between processes.

A record is a JSON head and raw array bytes, behind a sequence number and a CRC. There is no pickle: a hostile writer can at
most cause rejected records. A reader copies once and then checks the sequence number again.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import mmap
import os
import struct
import types
import typing
import zlib
from enum import Enum
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

T = TypeVar("T")

_HEAD = struct.Struct("<8sqIIq")  # magic, sequence, length, CRC, sequence again
_MAGIC = b"UAVCHAN1"
_DECODE_ERRORS = (struct.error, TypeError, IndexError, KeyError, AttributeError, OverflowError, RecursionError, SyntaxError)


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


class FileChannel(Generic[T]):
    """A channel in a memory-mapped file, with one writer and any number of readers.

    The file survives a crash of either side.
    """

    def __init__(self, path: Path, kind: type[T], capacity_bytes: int = 1 << 16) -> None:
        self._path = path
        self._kind = kind
        self._capacity = capacity_bytes + _HEAD.size
        self._map = _map_file(path, self._capacity)
        self._read_sequence = -1
        self._value = cast("T | None", None)

    def publish(self, value: T) -> None:
        """Replace the value. Raises ValueError if it exceeds the capacity."""
        data = encode(value)
        if len(data) + _HEAD.size > self._capacity:
            raise ValueError(f"{self._path.name}: {len(data)} bytes do not fit in {self._capacity - _HEAD.size}")
        sequence = self.sequence() + 1
        self._map[: _HEAD.size] = _HEAD.pack(_MAGIC, sequence, len(data), zlib.crc32(data), -1)  # -1: being written
        self._map[_HEAD.size : _HEAD.size + len(data)] = data
        self._map[: _HEAD.size] = _HEAD.pack(_MAGIC, sequence, len(data), zlib.crc32(data), sequence)

    def latest(self) -> T | None:
        """Return the newest value; for a torn or invalid record, return the previous value."""
        magic, sequence, length, crc, sequence_end = _HEAD.unpack(self._map[: _HEAD.size])
        if magic != _MAGIC or sequence == self._read_sequence:
            return self._value
        if sequence != sequence_end or length > self._capacity - _HEAD.size:
            return self._value
        data = self._map[_HEAD.size : _HEAD.size + length]
        if zlib.crc32(data) != crc:
            return self._value
        self._read_sequence = sequence
        try:
            self._value = decode(data, self._kind)
        except ValueError:  # from a hostile or foreign writer: reject the record once
            return self._value
        return self._value

    def sequence(self) -> int:
        """Return the number of values published."""
        magic, sequence, *_ = _HEAD.unpack(self._map[: _HEAD.size])
        return int(sequence) if magic == _MAGIC else 0


def _map_file(path: Path, size: int) -> mmap.mmap:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        if os.fstat(descriptor).st_size < size:
            os.ftruncate(descriptor, size)
        return mmap.mmap(descriptor, size)
    finally:
        os.close(descriptor)


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


def _encode(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return len(arrays) - 1
    if isinstance(value, Enum):
        return value.value
    if dataclasses.is_dataclass(value):
        return [_encode(getattr(value, f.name), arrays) for f in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [_encode(item, arrays) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value


def decode(data: bytes, kind: type[T]) -> T:
    """Decode the bytes of encode() by the declared types.

    Raises ValueError on bytes that do not fit.
    """
    try:
        (length,) = struct.unpack_from("<I", data)
        tree = json.loads(data[4 : 4 + length])
        arrays = _read_arrays(data, 4 + length)
        return cast("T", _decode(tree, kind, arrays))
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
        count = int(np.prod(shape, dtype=np.int64))
        array = np.frombuffer(data, dtype, count, offset).reshape(shape)
        array.setflags(write=False)
        arrays.append(array)
        offset += array.nbytes
    return arrays


@functools.cache
def _fields(kind: type) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(kind)
    return [(f.name, hints[f.name]) for f in dataclasses.fields(kind)]


def _decode_union(tree: Any, kinds: tuple[Any, ...], arrays: list[np.ndarray[Any, Any]]) -> Any:
    """Decode a value of one type or None, or of several types that JSON distinguishes.

    These are numbers and text.
    """
    if tree is None:
        return None
    inner = [a for a in kinds if a is not type(None)]
    if len(inner) == 1:
        return _decode(tree, inner[0], arrays)
    if type(tree) not in inner:
        raise ValueError(f"{type(tree).__name__} is none of {inner}")
    return tree


def _decode(tree: Any, kind: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    origin = typing.get_origin(kind)
    if origin is np.ndarray:
        return arrays[tree]
    if origin in (types.UnionType, typing.Union):
        return _decode_union(tree, typing.get_args(kind), arrays)
    if origin is tuple:
        arguments = typing.get_args(kind)
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return tuple(_decode(item, arguments[0], arrays) for item in tree)
        return tuple(_decode(item, a, arrays) for item, a in zip(tree, arguments, strict=True))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(tree)
    if dataclasses.is_dataclass(kind):
        fields = _fields(cast("type", kind))
        if len(fields) != len(tree):
            raise ValueError(f"{kind} has {len(fields)} fields, got {len(tree)}")
        make = cast("Any", kind)
        return make(**{name: _decode(item, hint, arrays) for (name, hint), item in zip(fields, tree, strict=True)})
    return kind(tree)
