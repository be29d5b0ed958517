"""Channels for quick lockstep: values are handed over as they are, since they are frozen and no process lies between."""

from __future__ import annotations

from typing import Generic, TypeVar

from uav_recon.app.flight_channels import FlightChannels

T = TypeVar("T")


class DirectChannel(Generic[T]):
    """A last-value channel in one process without encoding; its readers must not outlive what a value lends them."""

    def __init__(self) -> None:
        self._value: T | None = None
        self._sequence = 0

    def publish(self, value: T) -> None:
        """Replace the value."""
        self._value = value
        self._sequence += 1

    def latest(self) -> T | None:
        """The newest value."""
        return self._value

    def sequence(self) -> int:
        """Values published so far."""
        return self._sequence


def direct_channels() -> FlightChannels:
    """All of a flight's channels."""
    return FlightChannels(
        DirectChannel(), DirectChannel(), DirectChannel(), DirectChannel(), DirectChannel(), DirectChannel(),
        DirectChannel(), DirectChannel(), DirectChannel(), DirectChannel(), DirectChannel(),
    )  # fmt: skip
