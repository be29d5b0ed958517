"""Relay between a firmware and the product through a proxy, for faults on the link."""

from __future__ import annotations

from typing import Protocol

from sitl.autopilots.byte_links import UdpPeer


class ProductLink(Protocol):
    """The link to the product, as seen from the autopilot."""

    def read(self) -> bytes:
        """Return the bytes from the product that the injected faults let through."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes from the autopilot."""
        ...


class Relay:
    """Relay that receives from the firmware on `port`; call pass_on() every few milliseconds."""

    def __init__(self, product: ProductLink, port: int = 0) -> None:
        """Open the port; 0 is any free one. Raises OSError if it is not available."""
        self._product = product
        self._firmware = UdpPeer(local_port=port, remote=None)

    @property
    def port(self) -> int:
        """The port to which the firmware sends."""
        return self._firmware.local_port

    def pass_on(self) -> None:
        """Forward all waiting bytes in both directions."""
        while data := self._firmware.read():
            self._product.write(data)
        while data := self._product.read():
            self._firmware.write(data)

    def close(self) -> None:
        """Close the port."""
        self._firmware.close()
