"""Check of the autopilot's address as written in the config."""

from __future__ import annotations

BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600, 1000000, 1500000, 2000000, 3000000)
EVERYWHERE = ("0.0.0.0", "::", "*")  # noqa: S104  (refused, not used)


def link_address(url: str) -> str:
    """Return the url unchanged if it is a possible udp:HOST:PORT or serial:DEVICE:BAUD.

    Raises ValueError, one line, if it is not.
    """
    kind, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "serial") or not place or not (number.isascii() and number.isdigit()):
        raise ValueError("want udp:HOST:PORT or serial:DEVICE:BAUD")
    if kind == "serial" and int(number) not in BAUDS:
        raise ValueError(f"want one of {', '.join(map(str, BAUDS))} baud")
    if kind == "udp" and not 0 < int(number) < 65536:
        raise ValueError("want a port of 1 to 65535")
    if kind == "udp" and place in EVERYWHERE:
        raise ValueError("want one address; listening on every network would let anybody fly")
    return url
