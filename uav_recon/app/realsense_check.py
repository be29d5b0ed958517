"""Check of a connected RealSense camera.

Device, offers, chosen streams, clocks, IMU, and what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from uav_recon.clock import MonotonicClock
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock
from uav_recon.sensors.realsense import RealSenseCamera
from uav_recon.sensors.realsense_device import (
    DeviceInfo,
    Devices,
    connected_devices,
    device_errors,
    find_device,
    library,
    stream_offers,
)
from uav_recon.sensors.stream_format import StreamError
from uav_recon.sensors.stream_profiles import StreamKind, StreamProfile
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, ImuSample
from uav_recon.types.pose import Pose
from uav_recon.types.reason_code import ReasonCode

SECONDS = 4.0  # automatic exposure and the clocks have settled after half of it
_TICK_S = 0.01
_FEW_SHARE = 0.8  #: warn: fewer frames or samples than this share of their rate
_EMPTY_SHARE = 0.2  #: warn: fewer returns in the depth image than this share
_OLD_S = 0.15  #: warn: the median frame is older on arrival
_GRAVITY_MPS2 = (9.3, 10.3)  #: warn: a mean specific force at rest outside of this


@dataclass
class CameraSample:
    """Frames and inertial samples of some seconds. ages_s: of each frame, when it was read."""

    seconds: float
    frames: list[Frame] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    samples: list[ImuSample] = field(default_factory=list)


def check_realsense(
    clock: Clock | None = None,
    show: Callable[[str], None] = print,
    serial: str | None = None,
    devices: Devices = connected_devices,
    seconds: float = SECONDS,
) -> int:
    """Print what a camera is and does, with a line `!` for each thing that is wrong.

    Blocks for the seconds that it listens, and for those that the camera needs to open. Returns 0 if nothing is wrong, 1
    otherwise. Raises UserError (one line) if no camera can be opened.
    """
    clock = clock or MonotonicClock()
    try:
        device = find_device(devices, serial)
        with device_errors("opening"):
            _show_device(show, DeviceInfo.of(device), stream_offers(device)[0])
        camera = RealSenseCamera(clock, serial, body_from_depth=Pose.from_matrix(BODY_FROM_OPTICAL), devices=lambda: [device])
    except StreamError as error:
        raise UserError(str(error)) from None
    try:
        show(f"chosen      {camera.choice.reason}")
        show(f"listening   for {seconds:.0f} s; keep the camera at rest, facing the room")
        sample = listen(camera, clock, seconds)
        _show_sample(show, camera, sample)
        wrong = [*remarks_of(camera), *faults_of(camera, sample)]
    except StreamError as error:
        wrong = [f"{error}; plug it in again, with a short USB 3 cable"]
    finally:
        camera.close()
    for line in wrong:
        show(f"! {line}")
    show("nothing is wrong" if not wrong else f"{len(wrong)} to look at")
    return 1 if wrong else 0


def listen(camera: RealSenseCamera, clock: Clock, seconds: float) -> CameraSample:
    """Read frames and samples for some seconds after the first frame.

    Raises RealSenseError if none comes.
    """
    sample, end_s = CameraSample(seconds), clock.now_s() + 10.0 + seconds
    while clock.now_s() < end_s:
        clock.sleep_until(clock.now_s() + _TICK_S)
        frame, samples = camera.poll(), camera.imu()
        if frame is not None:
            if not sample.frames:
                end_s = clock.now_s() + seconds
            sample.frames.append(frame)
            sample.ages_s.append(clock.now_s() - frame.stamp_s)
        if sample.frames:
            sample.samples += samples
    return sample


def remarks_of(camera: RealSenseCamera) -> list[str]:
    """Return what the driver finds wrong, as text with the remedy."""
    return [reason.text() for reason in camera.remarks() if reason.code is not ReasonCode.CAMERA_STREAMS]


def faults_of(camera: RealSenseCamera, sample: CameraSample) -> list[str]:
    """Return what is wrong with the frames and samples, each with its remedy."""
    choice, found = camera.choice, []
    if not sample.frames:
        return ["no frame came: plug the camera in again, use a USB 3 port and a short cable"]
    rate_hz = len(sample.frames) / sample.seconds
    if rate_hz < _FEW_SHARE * choice.depth.rate_hz:
        found.append(f"frames at {rate_hz:.1f} Hz, want {choice.depth.rate_hz} Hz: no other device on this USB hub, less load")
    filled = float(np.median([np.isfinite(frame.depth_m).mean() for frame in sample.frames]))
    if filled < _EMPTY_SHARE:
        found.append(f"returns in {filled:.0%} of the depth pixels: uncover and clean the lens, look into the room")
    age_s = float(np.median(sample.ages_s))
    if age_s > _OLD_S:
        found.append(f"frames are {age_s:.2f} s old when they come, want at most {_OLD_S:.2f} s: USB 3, less load")
    return found + (_imu_faults(sample, choice.gyro) if choice.gyro is not None else [])


def _imu_faults(sample: CameraSample, gyro: StreamProfile) -> list[str]:
    found = []
    rate_hz = len(sample.samples) / sample.seconds
    if rate_hz < _FEW_SHARE * gyro.rate_hz:
        found.append(f"inertial samples at {rate_hz:.0f} Hz, want {gyro.rate_hz} Hz: update the firmware, less load")
    if len(sample.samples) < 2:
        return found
    for name, values in (
        ("gyro", np.array([one.gyro_radps for one in sample.samples])),
        ("accelerometer", np.array([one.specific_force_mps2 for one in sample.samples])),
    ):
        if (values == values[0]).all():
            found.append(f"the {name} repeats one value: plug the camera in again; on JetPack 6 use the RSUSB backend")
    force_mps2 = float(np.linalg.norm(np.mean([one.specific_force_mps2 for one in sample.samples], axis=0)))
    low_mps2, high_mps2 = _GRAVITY_MPS2
    if not low_mps2 <= force_mps2 <= high_mps2:
        found.append(f"specific force {force_mps2:.2f} m/s² at rest, want {low_mps2} to {high_mps2}: calibrate the IMU")
    return found


def _show_device(show: Callable[[str], None], info: DeviceInfo, offers: list[StreamProfile]) -> None:
    warm = "" if info.temperature_c is None else f", {info.temperature_c:.0f} °C"
    show(f"device      {info.name or 'unknown'}, serial {info.serial or 'unknown'}{warm}")
    show(f"firmware    {info.firmware or 'unknown'} with SDK {library().__version__}")
    show(f"usb         {info.usb or 'unknown'}{' (few streams, later frames)' if info.usb2 else ''}")
    for kind in StreamKind:
        texts = sorted({offer.text() for offer in offers if offer.kind is kind})
        show(f"offers      {kind.value}: {', '.join(texts) or 'none'}")


def _show_sample(show: Callable[[str], None], camera: RealSenseCamera, sample: CameraSample) -> None:
    if sample.frames:
        filled = float(np.median([np.isfinite(frame.depth_m).mean() for frame in sample.frames]))
        low_s, middle_s, high_s = np.percentile(sample.ages_s, [5, 50, 95])
        show(
            f"frames      {len(sample.frames)} in {sample.seconds:.1f} s, {camera.dropped_frames} dropped; "
            f"returns in {filled:.0%}; age {1000 * middle_s:.0f} ms ({1000 * low_s:.0f} to {1000 * high_s:.0f})"
        )
    emitter = {None: "unknown (no metadata)", True: "on", False: "off"}[camera.emitter]
    show(f"emitter     {emitter}; its dots are infrared and not in the colour image")
    domains = ", ".join(f"{stream} {domain.value}" for stream, domain in sorted(camera.domains().items()))
    show(f"clocks      {domains or 'none'}")
    count = len(sample.samples)
    show(f"imu         {count} samples, {count / sample.seconds:.0f} Hz" if camera.choice.gyro else "imu         none")
