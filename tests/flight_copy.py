"""Copies of a vehicle in mid-air, each of which can be flown on."""

from __future__ import annotations

import copyreg
import pickle
import struct
from typing import TypeVar, cast

T = TypeVar("T")

copyreg.pickle(struct.Struct, lambda layout: (struct.Struct, (layout.format,)))  # of pymavlink's codec


def flight_copy(flight: T) -> T:
    """Return a copy that shares nothing with the flight, in a third of the time of copy.deepcopy()."""
    return cast("T", pickle.loads(pickle.dumps(flight, pickle.HIGHEST_PROTOCOL)))
