"""Channels for quick lockstep: frozen values are passed by reference, without encoding."""

from __future__ import annotations

import dataclasses
from typing import Any, Generic, TypeVar

from uav_recon.app.flight_channels import FlightChannels

T = TypeVar("T")


class DirectChannel(Generic[T]):
    """A last-value channel within one process, without encoding.

    A reader must not keep a value longer than the buffers that the value refers to are valid.
    """

    def __init__(self) -> None:
        self._value: T | None = None
        self._sequence = 0

    def publish(self, value: T) -> None:
        """Replace the value."""
        self._value = value
        self._sequence += 1

    def latest(self) -> T | None:
        """Return the newest value; None before the first."""
        return self._value

    def sequence(self) -> int:
        """Return the number of published values."""
        return self._sequence


def direct_channels() -> FlightChannels:
    """Return all channels of a flight."""
    return FlightChannels(**{field.name: DirectChannel[Any]() for field in dataclasses.fields(FlightChannels)})
