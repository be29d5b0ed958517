"""Between a firmware and the product: what goes to and fro passes a proxy at the product's end."""

from __future__ import annotations

from typing import Protocol

from sitl.autopilots.byte_links import UdpPeer


class Passage(Protocol):
    """The product's end of the link, as an autopilot has it."""

    def read(self) -> bytes:
        """What the product said and the troubles let through."""
        ...

    def write(self, data: bytes) -> None:
        """What the autopilot says."""
        ...


class Relay:
    """The firmware is to send to port; pass_on() has to be called every few milliseconds."""

    def __init__(self, product: Passage, port: int = 0) -> None:
        """port 0 is any that is free. Raises OSError if it cannot be had."""
        self._product, self._firmware = product, UdpPeer(local_port=port, remote=None)

    @property
    def port(self) -> int:
        """Where the firmware is to send."""
        return self._firmware.local_port

    def pass_on(self) -> None:
        """All that waits, both ways."""
        while data := self._firmware.read():
            self._product.write(data)
        while data := self._product.read():
            self._firmware.write(data)

    def close(self) -> None:
        """Release the port."""
        self._firmware.close()
