"""Frames over one byte link: decoded on the way in, signed on the way out, all recorded."""

from __future__ import annotations

from collections.abc import Iterator

from uav_recon.autopilot.mavlink.codec import Decoder
from uav_recon.autopilot.mavlink.messages import Received
from uav_recon.autopilot.mavlink.signing import Signer
from uav_recon.autopilot.mavlink.tlog import FrameLog
from uav_recon.interfaces import ByteLink
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class FrameExchange:
    """Never raises on a byte link that fails.

    ``failure``: why the byte link failed last, None once it was read again.
    """

    def __init__(self, bytes_link: ByteLink, log: FrameLog, signer: Signer) -> None:
        self._bytes = bytes_link
        self._log = log
        self._signer = signer
        self._decoder = Decoder()
        self.failure: Reason | None = None

    @property
    def mavlink1_frames(self) -> int:
        """Number of frames of MAVLink 1 until now; none of them is decoded."""
        return self._decoder.mavlink1_frames

    def read(self, now_s: float) -> Iterator[Received] | None:
        """Return the received frames, each recorded when it is taken; None if the byte link failed."""
        try:
            data = self._bytes.read()
        except OSError as error:
            self._note_failure(error)
            return None
        self.failure = None
        return self._recorded(self._decoder.feed(data), now_s)

    def write(self, frame: bytes, now_s: float) -> None:
        """Sign, send and record a frame."""
        frame = self._signer.put(frame, now_s)
        try:
            self._bytes.write(frame)
        except OSError as error:
            self._note_failure(error)
            return
        self._log.record(now_s, frame)

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are available or the timeout ends."""
        self._bytes.wait(timeout_s)

    def _recorded(self, frames: list[Received], now_s: float) -> Iterator[Received]:
        for received in frames:
            self._log.record(now_s, received.frame)
            yield received

    def _note_failure(self, error: OSError) -> None:
        self.failure = Reason(ReasonCode.LINK_ERROR, (error.strerror or str(error),))
