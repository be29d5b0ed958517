"""Flights of a vehicle whose autopilot navigates by itself, in a frame that is turned and elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from flight_rig import Rig, setpoints
from test_pilot_flight_ardupilot import CopterRig

from sitl.world.onboard_tracker import OnboardTracker
from uav_recon.autopilot.link.navigation import AutopilotNavigation
from uav_recon.autopilot.link.reported_poses import LocalPositionPoses, OdometryPoses, PoseReports
from uav_recon.sensors.autopilot_poses import AutopilotPoses
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.vehicle import FlightPhase

VARIANCE = np.full(6, 1e-4)


class OwnNavigation(Rig):
    """The truth goes to the autopilot's own tracker, late; odometry is the truth, as perception would give it at the pad."""

    def __init__(self, reports: type[PoseReports]) -> None:
        self.reports = reports
        super().__init__()
        self.tracker = OnboardTracker(4, self.autopilot.fuse_own)
        self.source = AutopilotPoses(self.channels.reported)
        self.poses_read: list[StampedPose] = []
        self._seen: list[tuple[float, FloatArray, FloatArray]] = []

    def navigation(self) -> AutopilotNavigation:
        return AutopilotNavigation(self.reports())

    def step(self) -> None:
        if self.turn % 7 == 0:
            truth = self.autopilot.truth()
            self._seen.append((truth.stamp_s, np.array(truth.position), np.array(truth.quat_wxyz)))
            if len(self._seen) > 1:
                self.tracker.write_pose(*self._seen.pop(0), VARIANCE, 100, 0)
        super().step()
        self.poses_read += self.source.poses()

    def place(self) -> FloatArray:
        return np.array(self.autopilot.truth().position)


class OwnNavigationCopter(OwnNavigation, CopterRig):
    pass


FLIGHTS = [
    pytest.param(OwnNavigation, OdometryPoses, id="px4"),
    pytest.param(OwnNavigationCopter, LocalPositionPoses, id="ardupilot", marks=pytest.mark.nightly),
]


@pytest.mark.parametrize(("rig_kind", "reports"), FLIGHTS)
def test_it_flies_in_odom_though_the_autopilot_lives_in_another_frame(
    rig_kind: type[OwnNavigation], reports: type[PoseReports]
) -> None:
    rig = rig_kind(reports)
    rig.take_off_and_hover()
    rig.fly((1.5, 1.0, 1.1))
    rig.run(8.0)
    assert np.linalg.norm(rig.place() - (1.5, 1.0, 1.1)) < 0.08
    assert rig.tap.since(0.0)["ODOMETRY"] == 0  # its own pose must not come back to it
    _, places = setpoints(rig)
    assert np.linalg.norm(places[-1][:2] - (1.5, 1.0)) > 1.0  # they are in its frame
    tracker_from_odom = Pose(np.array(rig.tracker._turn), rig.tracker._shift_m)
    newest = rig.poses_read[-1]
    assert rig.clock.now_s() - newest.stamp_s < 0.1
    true = tracker_from_odom @ Pose(np.array(rig.autopilot.truth().quat_wxyz), rig.place())
    apart = true.inverse() @ newest.odom_from_body
    assert np.linalg.norm(apart.translation_m) < 0.05
    assert np.linalg.norm(apart.rotation_vector()) < 0.03
    assert len(rig.poses_read) > 25 * (rig.poses_read[-1].stamp_s - rig.poses_read[0].stamp_s)

    before, resets = rig.place(), newest.reset_counter
    rig.tracker.step((0.6, -0.3, 0.1), 0.4)  # a loop closure: setpoints of the old frame would lead 0.7 m aside
    for _ in range(400):
        rig.step()
        assert np.linalg.norm(rig.place() - before) < 0.15
    assert rig.poses_read[-1].reset_counter == resets + 1
    assert rig.pilot.phase is FlightPhase.FLYING


def test_it_is_not_ready_without_odometry() -> None:
    rig = OwnNavigation(LocalPositionPoses)
    rig.poses = False
    rig.run(20.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.poses_read
    assert rig.note_codes == ("no-pose-fed",)


def test_it_lands_if_odometry_ends() -> None:
    rig = OwnNavigation(LocalPositionPoses)
    rig.take_off_and_hover()
    rig.poses = False
    rig.until(FlightPhase.LANDING, 3.0)
