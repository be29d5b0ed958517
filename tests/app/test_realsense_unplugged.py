"""A camera that is gone in flight or at touchdown: odometry goes on until the vehicle has landed."""

from __future__ import annotations

import numpy as np
import pytest
from software_realsense import Rig, SoftwareRealSense

from uav_recon.app.flight_channels import memory_channels
from uav_recon.app.processes import run_perception
from uav_recon.clock import ManualClock
from uav_recon.config import LocalizationConfig
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.perception.perception import Perception
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState

MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.0)


class _Flight(ManualClock):
    """A vehicle that stands in the air; poses come from another source, and the camera is unplugged and plugged in again."""

    def __init__(self, *, gone_s: float, back_s: float, lands_s: float, ends_s: float = 1e9) -> None:
        super().__init__(100.0)
        self.gone_s, self.back_s, self.lands_s, self.ends_s = gone_s, back_s, lands_s, ends_s
        self.channels = memory_channels()
        self.rig = Rig(SoftwareRealSense(self), body_from_depth=MOUNT)
        self.perception = Perception(
            LocalizationConfig(), self.rig.camera, self, FixedMount(MOUNT), self.channels, self, remarks=self.rig.camera.remarks
        )
        self.frames_s: list[float] = []
        self.odom_s: list[float] = []
        self.codes: set[ReasonCode] = set()
        self._sent = self._posed = 0

    def poses(self) -> list[StampedPose]:
        """Return honest poses at 30 Hz."""
        due = int((self.now_s() - 100.0) * 30)
        out = [StampedPose(100.0 + k / 30, Pose.identity(), np.zeros(3)) for k in range(self._posed, due)]
        self._posed = due
        return out

    def sleep_until(self, instant_s: float) -> None:
        super().advance_to(max(instant_s, self.now_s()))
        since_s = self.now_s() - 100.0
        self.rig.connected = not self.gone_s <= since_s < self.back_s
        while self._sent < since_s * 30:
            self._sent += 1
            if self.rig.connected:
                self.rig.source.send(self.rig.size, self.rig.colour_size, self.now_s() - 0.005, depth_mm=1500 + self._sent % 3)
                self.rig.source.send_motion(self.now_s() - 0.002)

    def _step(self) -> None:
        before = self.channels.frames.sequence(), self.channels.odom.sequence()
        armed = self.now_s() - 100.0 < self.lands_s
        phase = FlightPhase.FLYING if armed else FlightPhase.LANDED
        self.channels.vehicle.publish(
            VehicleState(self.now_s(), Pose.identity(), np.zeros(3), armed, "", phase, 0.8, False, np.nan, -1, 0, None)
        )
        try:
            self.perception.step()
        finally:
            self.frames_s += [self.now_s() - 100.0] * (self.channels.frames.sequence() > before[0])
            self.odom_s += [self.now_s() - 100.0] * (self.channels.odom.sequence() > before[1])
            status = self.channels.perception.latest()
            self.codes |= {reason.code for reason in status.camera} if status else set()

    def run(self) -> str:
        return run_perception(self._step, self.channels.vehicle, self, lambda: self.now_s() - 100.0 > self.ends_s)

    def frames_between(self, from_s: float, to_s: float) -> int:
        return sum(from_s <= at_s < to_s for at_s in self.frames_s)


def test_a_camera_that_falls_off_at_touchdown_costs_no_pose_before_the_motors_stop() -> None:
    flight = _Flight(gone_s=10.0, back_s=1e9, lands_s=30.0)
    assert "lost, 3 restarts failed" in flight.run()
    assert flight.now_s() - 100.0 == pytest.approx(30.0, abs=0.05)
    assert np.diff([at_s for at_s in flight.odom_s if at_s > 1.0]).max() < 0.05
    assert flight.frames_between(5.0, 10.0) > 100
    assert flight.frames_between(10.1, 30.0) == 0
    assert ReasonCode.CAMERA_RESTARTS in flight.codes
    status = flight.channels.perception.latest()
    assert status is not None
    assert status.stamp_s - 100.0 > 28.5, "the status goes on"


def test_a_camera_that_is_plugged_in_again_is_used_again() -> None:
    flight = _Flight(gone_s=10.0, back_s=12.0, lands_s=19.0, ends_s=19.0)
    assert flight.run() == ""
    assert flight.frames_between(10.1, 12.0) == 0
    assert flight.frames_between(14.0, 19.0) > 140
    assert np.diff([at_s for at_s in flight.odom_s if at_s > 1.0]).max() < 0.05
