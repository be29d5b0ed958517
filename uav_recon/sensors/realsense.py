"""Intel RealSense depth cameras, live or from a recorder file (.db3), through librealsense.

librealsense puts pixel (0, 0) at the centre of the first pixel, as this project does (see its projection documentation), so
intrinsics are used unchanged. Its rotations are column-major. Inertial samples are in the axes of the camera and are rotated
to the body by the fixed mount.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.clock import DetachedExecutor
from uav_recon.interfaces import Clock, Executor
from uav_recon.sensors.exposure_lock import ExposureLock
from uav_recon.sensors.realsense_device import (
    ColourControls,
    DeviceInfo,
    Devices,
    ImageArrival,
    RealSenseError,
    RealSenseSession,
    connected_devices,
    device_errors,
    emitter_on,
    find_device,
    open_recording,
)
from uav_recon.sensors.realsense_faults import known_faults
from uav_recon.sensors.session_recovery import MAX_RESTARTS, SessionRecovery
from uav_recon.sensors.stamp_clock import DeviceClocks, StampDomain
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.sensors.stream_profiles import NoProfileError, StreamChoice, StreamKind
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

__all__ = ["RealSenseCamera", "RealSenseError", "check_camera"]

LOG = logging.getLogger(__name__)

_FIRST_FRAME_S = 5.0  #: hold: a camera without a frame after this time is opened again (the default timeout of librealsense)
_SILENCE_S = 1.5  #: hold: a camera without a frame for this time is opened again: the first restart is within 2 s (hazard C2)
_RESET_ATTEMPT = 3  #: internal: the attempt that resets the device before it is opened
_RESET_S = 3.0  #: internal: time for the device to come back after that
_PAIR_SHARE = 0.6  #: reject: depth without a colour image within this share of the time between two frames
_TICK_S = 0.01
_SAID_STEP_S = 0.05  #: internal: clocks are said to differ by multiples of this, so that a change of it is one line
_SPARSE = 8  #: internal: step of the pixels of an image that its brightness is taken from
_CLOSE_S = 2.0  #: internal: wait for the streams to stop when the process ends


def check_camera(playback: Path | None = None) -> None:
    """Check that a camera or recording can be opened.

    Raises RealSenseError without the library, the camera or the recording.
    """
    if playback is not None:
        open_recording(playback)
    else:
        find_device(connected_devices, None)


class RealSenseCamera:
    """Camera protocol over librealsense.

    The streams are chosen from what the device offers (stream_profiles), and their stamps are related to the companion's clock
    (stamp_clock). Raises RealSenseError or NoProfileError (one line) if there is no such camera or none of its streams fits.

    A camera that is silent is opened again up to three times, beside the control loop; meanwhile poll() returns None. After
    that poll() raises RealSenseError.

    serial: None selects the first camera found. playback: a .db3 file instead of a camera. body_from_depth: the fixed mount,
    only used to rotate inertial samples to body axes; without it there are none. devices: lists the connected devices.
    executor: starts each call that may block for ever at once, beside the control loop; None: on a thread.

    dropped_frames counts frames that are not newer than the one before, have no colour image of the same time, come less
    than half a second after a change of the stamp clock, or whose stamps are those of no clock. Opening takes seconds; poll()
    and imu() never block.
    """

    def __init__(
        self,
        clock: Clock,
        serial: str | None = None,
        playback: Path | None = None,
        depth_min_m: float = 0.3,
        depth_max_m: float = 6.0,
        body_from_depth: Pose | None = None,
        wall_s: Callable[[], float] = time.time,
        devices: Devices = connected_devices,
        executor: Executor | None = None,
    ) -> None:
        self._clock = clock
        self._wall_s = wall_s
        self._devices = devices
        self._executor = executor or DetachedExecutor("camera")
        self._playback = playback
        self._body_from_depth = body_from_depth
        self._depth_range_m = (depth_min_m, depth_max_m)
        self.dropped_frames = 0
        self._before_s = -math.inf
        self._said: set[Reason] = set()
        self._lost_by = ""
        self._emitter: bool | None = None
        self._near_flight: Callable[[], bool] | None = None
        device = find_device(devices, serial) if playback is None else open_recording(playback)
        self._recovery = SessionRecovery[RealSenseSession](self._reopen, self._executor, RealSenseError)
        self._session: RealSenseSession | None = None
        self._use(self._open(device))
        # start of the silence (inf: never polled), and its limit
        self._silent_s = math.inf
        self._silence_limit_s = _FIRST_FRAME_S
        self._say(self.remarks())

    def lock_exposure(self, near_flight: Callable[[], bool]) -> None:
        """Lock the colour camera's exposure and white balance while near_flight() is True."""
        self._near_flight = near_flight

    # ---- sessions ----------------------------------------------------------------------------------------------------

    def _open(self, device: Any) -> RealSenseSession:
        want_imu = self._body_from_depth is not None
        with device_errors("opening"):  # it may go at any moment
            return RealSenseSession(device, self._clock, self._wall_s, want_imu=want_imu, playback=self._playback)

    def _reopen(self, attempt: int) -> RealSenseSession:
        """Open the same camera again, by a new context; runs on a thread of its own, and may block."""
        try:
            device = find_device(self._devices, self._serial)
            if attempt == _RESET_ATTEMPT:
                with suppress(RuntimeError):  # a device without it is opened as it is
                    device.hardware_reset()
                self._clock.sleep_until(self._clock.now_s() + _RESET_S)
                device = find_device(self._devices, self._serial)
            return self._open(device)
        except NoProfileError as error:
            raise RealSenseError(str(error)) from None

    def _use(self, session: RealSenseSession) -> None:
        self._session = session
        self._info, self._choice = session.info, session.choice
        LOG.info("%s, firmware %s: %s", session.info.name, session.info.firmware, session.choice.reason)
        self._serial = session.info.serial or None
        self._name = f"RealSense {self._playback or session.info.serial}"
        self._clocks = DeviceClocks()
        self._table = depth_lookup_table(*self._depth_range_m, session.metres_per_unit)
        self._pair_s = _PAIR_SHARE / session.choice.depth.rate_hz
        self._number = -1
        self._colours: deque[tuple[float, Any]] = deque(maxlen=8)  # stamp on the companion's clock, image
        self._waiting: tuple[float, ImageArrival] | None = None  # depth whose colour has not come yet
        self._force: FloatArray | None = None
        self._exposure = ExposureLock(
            ColourControls(session.colour_sensor), self._executor, RealSenseError, self._clock.now_s()
        )
        self._body_from_imu: FloatArray | None = None
        if self._body_from_depth is not None and session.has_imu:
            self._body_from_imu = self._body_from_depth.rotation() @ session.depth_from_imu

    def _recover(self, now_s: float) -> None:
        """Take the next step of a restart. Raises RealSenseError after the last attempt."""
        if self._recovery.exhausted:
            failure = self._recovery.failure or self._lost_by
            raise RealSenseError(f"{self._name}: lost, {MAX_RESTARTS} restarts failed ({failure}): reconnect it")
        attempts = self._recovery.attempts
        session = self._recovery.step(now_s)
        if self._recovery.attempts > attempts:
            self._say((self._restart_remark(),))
        if session is not None:
            self._use(session)
            self._silent_s, self._silence_limit_s = now_s, _FIRST_FRAME_S
            LOG.warning("%s: open again", self._name)

    def _lose(self, failure: str, now_s: float) -> None:
        """Give up a session that sends nothing."""
        session, self._session = self._session, None
        self._colours.clear()
        self._waiting = None
        self._lost_by = failure
        LOG.warning("%s: %s", self._name, failure)
        self._recovery.begin(session, now_s)

    # ---- frames ------------------------------------------------------------------------------------------------------

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned yet, or None.

        Raises RealSenseError if the camera is lost and could not be opened again.
        """
        now_s = self._clock.now_s()
        if self._session is None:
            self._recover(now_s)
            return None
        heard, frame = self._newest(self._session, now_s)
        if self._playback is None:
            self._check_silence(heard, now_s)
        if frame is not None and self._near_flight is not None and self._playback is None:
            self._exposure.step(now_s, self._near_flight(), float(frame.rgb[::_SPARSE, ::_SPARSE].mean()))
        if heard:
            self._say(self.remarks())
        return frame

    def _newest(self, session: RealSenseSession, now_s: float) -> tuple[bool, Frame | None]:
        """Return whether an image pair has arrived, and the newest valid frame."""
        while session.colour:
            image = session.colour.popleft()
            self._colours.append((self._stamp_s("colour", image), image.image))
        heard, newest = False, None
        while session.depth:
            image = session.depth.popleft()
            stamp_s = self._stamp_s("depth", image)
            if image.number != self._number:
                if self._waiting is not None:
                    self.dropped_frames += 1
                self._number, self._waiting = image.number, (stamp_s, image)
        if self._waiting is not None:
            heard, newest = self._paired(session, now_s)
        return heard, newest

    def _paired(self, session: RealSenseSession, now_s: float) -> tuple[bool, Frame | None]:
        """Join the waiting depth image with the colour image of the same time, if that has arrived."""
        assert self._waiting is not None
        stamp_s, depth = self._waiting
        beside = [pair for pair in self._colours if abs(pair[0] - stamp_s) <= self._pair_s]
        if not beside:
            if now_s - depth.arrival_s > 2.0 * self._pair_s:
                self._waiting = None
                self.dropped_frames += 1
            return False, None
        colour = min(beside, key=lambda pair: abs(pair[0] - stamp_s))[1]
        self._waiting = None
        self._emitter = emitter_on(depth.image)
        faults = {fault.stream for fault in self._clocks.faults()}
        newer = stamp_s > self._before_s
        self._before_s = stamp_s
        if not newer or not self._clocks.settled("depth", depth.arrival_s) or "depth" in faults:
            self.dropped_frames += 1
            return True, None
        return True, Frame(
            stamp_s,
            depth.number,
            self._table[np.asanyarray(depth.image.get_data())],
            session.depth_intrinsics,
            np.asanyarray(colour.get_data()),
            session.colour_intrinsics,
            session.colour_from_depth,
        )

    def _stamp_s(self, stream: str, image: ImageArrival) -> float:
        return self._clocks.monotonic_s(stream, image.domain, image.stamp_s, image.arrival_s, image.wall_s)

    def _check_silence(self, heard: bool, now_s: float) -> None:
        """Begin a restart after a long silence.

        The first silence starts at the first poll, because kernels may compile before it.
        """
        if heard:
            self._silent_s, self._silence_limit_s = now_s, _SILENCE_S
        self._silent_s = min(self._silent_s, now_s)
        if now_s - self._silent_s > self._silence_limit_s:
            self._lose(f"no frame for {now_s - self._silent_s:.1f} s", now_s)

    # ---- inertial samples ----------------------------------------------------------------------------------------------

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call.

        One per gyro reading, with the newest specific force before it, in order of arrival; none without an IMU, or while the
        stamps of the gyro are those of no clock. The lever arm is neglected.
        """
        session, body_from_imu = self._session, self._body_from_imu
        if session is None or body_from_imu is None:
            return []
        out: list[ImuSample] = []
        while session.samples:
            kind, values, domain, stamp_s, arrival_s, wall_s = session.samples.popleft()
            stamp_s = self._clocks.monotonic_s(kind.value, domain, stamp_s, arrival_s, wall_s)
            turned = body_from_imu @ np.array(values)
            if kind is StreamKind.ACCEL:
                self._force = turned
            elif self._force is not None and self._clocks.settled(kind.value, arrival_s):
                out.append(ImuSample(stamp_s, turned, self._force))
        refused = any(fault.stream in ("gyro", "accel") for fault in self._clocks.faults())
        return [] if refused else out

    # ---- description -------------------------------------------------------------------------------------------------

    @property
    def info(self) -> DeviceInfo:
        """The description of the device by itself."""
        return self._info

    @property
    def choice(self) -> StreamChoice:
        """The chosen streams."""
        return self._choice

    @property
    def emitter(self) -> bool | None:
        """True if the infrared emitter was on in the newest depth image; None if unknown."""
        return self._emitter

    def domains(self) -> dict[str, StampDomain]:
        """Return the stamp clock of each stream that has sent something."""
        return self._clocks.domains()

    # ---- remarks -------------------------------------------------------------------------------------------------------

    def remarks(self) -> tuple[Reason, ...]:
        """Return what an operator should know of the camera: its streams, then what is wrong."""
        info, choice = self._info, self._choice
        imu = "none" if choice.gyro is None else choice.gyro.text()
        found = [Reason(ReasonCode.CAMERA_STREAMS, (choice.depth.text(), choice.colour.text(), imu, info.usb or "unknown"))]
        if info.usb2:
            found.append(Reason(ReasonCode.CAMERA_USB2, (info.usb, str(choice.depth.rate_hz))))
        for fault in known_faults(info.name, info.firmware, info.sdk):
            found.append(Reason(ReasonCode.CAMERA_FIRMWARE, (info.firmware, info.sdk, fault.effect, fault.remedy)))
        if choice.gyro is None:
            found.append(Reason(ReasonCode.CAMERA_WITHOUT_IMU))
        found += self._clock_remarks()
        if self._emitter is False:
            found.append(Reason(ReasonCode.CAMERA_EMITTER_OFF))
        if self._session is None:
            found.append(self._restart_remark())
        return tuple(found) if self._exposure.reason is None else (*found, self._exposure.reason)

    def _restart_remark(self) -> Reason:
        values = (max(self._recovery.attempts, 1), MAX_RESTARTS, self._recovery.failure or self._lost_by)
        return Reason(ReasonCode.CAMERA_RESTARTS, values)

    def _clock_remarks(self) -> list[Reason]:
        found = [Reason(ReasonCode.CAMERA_STAMPS_REFUSED, (fault.stream,)) for fault in self._clocks.faults()]
        domains, now_s = self._clocks.domains(), self._clock.now_s()
        depth, gyro = domains.get("depth"), domains.get("gyro")
        if depth is StampDomain.SYSTEM:
            found.append(Reason(ReasonCode.CAMERA_ARRIVAL_STAMPS))
        if depth is not None and gyro is not None and depth is not gyro:
            found.append(Reason(ReasonCode.CAMERA_DOMAINS, ("depth", depth.value, "gyro", gyro.value)))
        for stream in domains:
            behind_s = self._clocks.behind_s(stream, now_s)
            if behind_s is not None:
                found.append(Reason(ReasonCode.CAMERA_CLOCK_BEHIND, (stream, _stepped(behind_s))))
        apart_s = self._clocks.apart_s("depth", "gyro", now_s)
        if apart_s is not None:
            found.append(Reason(ReasonCode.CAMERA_CLOCKS_APART, ("depth", "gyro", _stepped(abs(apart_s)))))
        return found

    def _say(self, remarks: tuple[Reason, ...]) -> None:
        """Log what was not said before."""
        for reason in remarks:
            if reason not in self._said:
                self._said.add(reason)
                LOG.log(
                    logging.INFO if reason.code in (ReasonCode.CAMERA_STREAMS, ReasonCode.EXPOSURE_LOCKED) else logging.WARNING,
                    "%s",
                    reason.text(),
                )

    def close(self) -> None:
        """Stop the streams, for two seconds at most: librealsense may block for ever."""
        if self._session is None:
            return
        pending = self._executor.submit(self._session.close, 0.0)
        for _ in range(round(_CLOSE_S / _TICK_S)):
            if pending.done():
                return
            self._clock.sleep_until(self._clock.now_s() + _TICK_S)


def _stepped(seconds: float) -> float:
    """Return a time to the nearest _SAID_STEP_S."""
    return round(seconds / _SAID_STEP_S) * _SAID_STEP_S
