"""Depth images of a recording with their nearest colour images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")

PAIR_S = 0.05  #: reject: a depth image whose nearest colour image is farther away gets no colour (black)
_KEPT_COLOURS = 4


def paired(
    messages: Iterable[T],
    is_depth: Callable[[T], bool],
    is_colour: Callable[[T], bool],
    stamp_s: Callable[[T], float],
    step: int,
    *,
    colour: bool,
) -> Iterator[tuple[int, T, T | None]]:
    """Yield number and message of every step-th depth image, with its colour image or None.

    colour: True if there are colour images: a depth image waits for those after it. The messages are in the order of the file.
    """
    waiting: list[tuple[int, T]] = []
    colours: list[T] = []
    number = -1
    for message in messages:
        if is_colour(message):
            colours = [*colours[-_KEPT_COLOURS:], message]
        elif is_depth(message):
            number += 1
            if number % step == 0:
                waiting.append((number, message))
        while waiting and (not colour or _met(stamp_s(waiting[0][1]), colours, len(waiting), stamp_s)):
            yield *(one := waiting.pop(0)), _nearest(stamp_s(one[1]), colours, stamp_s)
    for one in waiting:
        yield *one, _nearest(stamp_s(one[1]), colours, stamp_s)


def _met(depth_s: float, colours: list[T], waiting: int, stamp_s: Callable[[T], float]) -> bool:
    """Return True if no later colour image can be nearer."""
    return waiting > _KEPT_COLOURS or (bool(colours) and stamp_s(colours[-1]) >= depth_s)


def _nearest(depth_s: float, colours: list[T], stamp_s: Callable[[T], float]) -> T | None:
    near = min(colours, key=lambda one: abs(stamp_s(one) - depth_s), default=None)
    return near if near is not None and abs(stamp_s(near) - depth_s) <= PAIR_S else None
