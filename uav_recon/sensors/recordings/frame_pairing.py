"""Depth images of a recording with their nearest colour images."""

from __future__ import annotations

import heapq
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
    order: Iterable[int],
    *,
    colour: bool,
) -> Iterator[tuple[int, T, T | None]]:
    """Yield number and message of each wanted depth image, with its colour image or None.

    The messages are in the order of the file. order: positions of the wanted depth images among all of them, in the order in
    which they are yielded; number: its place in that order. colour: True if there are colour images: a depth image waits for
    those after it.
    """
    places = {position: place for place, position in enumerate(order)}
    ahead: list[tuple[int, int, T, T | None]] = []  # images that came before one that is due earlier
    due = 0
    for position, depth, beside in _with_colour(messages, is_depth, is_colour, stamp_s, places, colour=colour):
        heapq.heappush(ahead, (places[position], position, depth, beside))
        while ahead and ahead[0][0] == due:
            place, _, first, its_colour = heapq.heappop(ahead)
            yield place, first, its_colour
            due += 1
    for place, _, first, its_colour in sorted(ahead, key=lambda one: one[0]):
        yield place, first, its_colour


def _with_colour(
    messages: Iterable[T],
    is_depth: Callable[[T], bool],
    is_colour: Callable[[T], bool],
    stamp_s: Callable[[T], float],
    wanted: dict[int, int],
    *,
    colour: bool,
) -> Iterator[tuple[int, T, T | None]]:
    """Yield the wanted depth images in the order of the file."""
    waiting: list[tuple[int, T]] = []
    colours: list[T] = []
    position = -1
    for message in messages:
        if is_colour(message):
            colours = [*colours[-_KEPT_COLOURS:], message]
        elif is_depth(message):
            position += 1
            if position in wanted:
                waiting.append((position, message))
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
