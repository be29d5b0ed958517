from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uav_recon.channels import MemoryChannel
from uav_recon.localization.pad_origin import PadOrigin
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason, codes_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState


@dataclass
class Source:
    waiting: list[StampedPose] = field(default_factory=list)

    def poses(self) -> list[StampedPose]:
        out, self.waiting = self.waiting, []
        return out


def _vehicle(armed: bool | None) -> MemoryChannel[VehicleState]:
    channel = MemoryChannel(VehicleState)
    if armed is not None:
        at = Pose.identity()
        channel.publish(
            VehicleState(1.0, at, np.zeros(3), armed, "OFFBOARD", FlightPhase.FLYING, 0.8, False, math.nan, 1, 0, None)
        )
    return channel


def _rig(folder: Path, armed: bool | None = False) -> tuple[PadOrigin, Source]:
    source = Source()
    return PadOrigin(source, _vehicle(armed), folder / "pad.json"), source


def _pose(stamp_s: float, pose: Pose, rng: np.random.Generator | None = None) -> StampedPose:
    noise = np.zeros(3) if rng is None else rng.normal(0.0, 0.002, 3)
    return StampedPose(stamp_s, Pose(pose.quat_wxyz, pose.translation_m + noise), np.array([0.1, 0.0, 0.0]))


SOURCE_FROM_PAD = Pose.from_yaw(math.radians(30.0), np.array([2.0, -1.0, 0.3]))


def test_the_world_begins_at_the_pad_whatever_the_source_calls_it(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    rng, pad_from_body = np.random.default_rng(1), Pose.from_yaw(0.4, np.array([1.0, 0.5, 1.2]))
    source.waiting = [_pose(k / 15, SOURCE_FROM_PAD, rng) for k in range(20)]
    rest = origin.poses()
    assert 10 <= len(rest) <= 13  # from half a second on
    assert np.linalg.norm([pose.odom_from_body.translation_m for pose in rest], axis=1).max() < 0.01
    source.waiting = [_pose(2.0, SOURCE_FROM_PAD @ pad_from_body)]
    (flown,) = origin.poses()
    np.testing.assert_allclose(flown.odom_from_body.translation_m, [1.0, 0.5, 1.2], atol=0.01)
    assert flown.odom_from_body.yaw_rad() == pytest.approx(0.4, abs=0.01)
    turned = Rotation.from_euler("z", -30, degrees=True).apply([0.1, 0.0, 0.0])
    np.testing.assert_allclose(flown.velocity_odom_mps, turned, atol=0.002)
    assert origin.reason is not None
    assert codes_of(origin.reason) == ("pad-is-origin",)
    assert origin.reason.values == pytest.approx((2.26, 30.0), abs=0.03)


def test_the_body_has_its_declared_heading_on_the_pad(tmp_path: Path) -> None:
    source = Source()
    origin = PadOrigin(source, _vehicle(False), tmp_path / "pad.json", heading_rad=math.radians(50.0))
    ahead = Pose.from_yaw(0.0, np.array([2.0, 0.0, 1.0]))
    source.waiting = [*(_pose(k / 15, SOURCE_FROM_PAD) for k in range(12)), _pose(2.0, SOURCE_FROM_PAD @ ahead)]
    *_, on_pad, flown = (pose.odom_from_body for pose in origin.poses())
    assert math.degrees(on_pad.yaw_rad()) == pytest.approx(50.0)
    np.testing.assert_allclose(on_pad.translation_m, 0.0, atol=1e-9)
    along = [2.0 * math.cos(math.radians(50.0)), 2.0 * math.sin(math.radians(50.0)), 1.0]
    np.testing.assert_allclose(flown.translation_m, along, atol=1e-9)


def test_a_source_that_begins_at_the_pad_is_not_reported(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    rng = np.random.default_rng(2)
    source.waiting = [_pose(k / 15, Pose.identity(), rng) for k in range(12)]
    assert origin.poses()
    assert origin.reason is None


def test_a_sloping_pad_does_not_tilt_the_world(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    slope = Pose.from_rotation_vector(np.array([0.0, math.radians(5.0), 0.0]), np.zeros(3))
    source.waiting = [_pose(k / 15, SOURCE_FROM_PAD @ slope) for k in range(12)]
    leaning = Rotation.from_quat(origin.poses()[-1].odom_from_body.quat_wxyz, scalar_first=True)
    assert math.degrees(leaning.magnitude()) == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(leaning.apply([0, 0, 1])[:2], [math.sin(math.radians(5.0)), 0.0], atol=1e-3)


def test_while_it_is_carried_there_is_no_pad(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    origin, source = _rig(tmp_path)
    awaited = origin.reason
    assert awaited == Reason(ReasonCode.PAD_AWAITED, (0.5,))
    source.waiting = [_pose(k / 15, Pose.from_yaw(0.0, np.array([0.1 * k, 0.0, 0.5]))) for k in range(45)]
    assert origin.poses() == []
    assert caplog.messages == []
    source.waiting = [_pose(3.0 + k / 15, Pose.from_yaw(0.0, np.array([0.1 * k, 0.0, 0.5]))) for k in range(45)]
    assert origin.poses() == []
    assert caplog.messages == ["no odometry yet: waiting until the pose source has been at rest on the pad for 0.5 s"]
    put_down = Pose.from_yaw(0.2, np.array([4.5, 0.0, 0.0]))
    source.waiting = [_pose(6.0 + k / 15, put_down) for k in range(12)]
    rest = origin.poses()
    assert rest
    assert codes_of(origin.reason) == ("pad-is-origin",)
    np.testing.assert_allclose(rest[-1].odom_from_body.translation_m, 0.0, atol=1e-6)


def test_poses_without_quality_or_with_a_pause_are_no_rest(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    source.waiting = [replace(_pose(k / 15, SOURCE_FROM_PAD), quality=0) for k in range(30)]
    assert origin.poses() == []
    source.waiting = [_pose(3.0 + 0.6 * k, SOURCE_FROM_PAD) for k in range(30)]
    assert origin.poses() == []


def test_a_restart_in_the_air_takes_up_the_pad_of_before(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    source.waiting = [_pose(k / 15, SOURCE_FROM_PAD) for k in range(12)]
    assert origin.poses()
    again, source = _rig(tmp_path, armed=True)
    source.waiting = [_pose(9.0, SOURCE_FROM_PAD @ Pose.from_yaw(0.0, np.array([3.0, 0.0, 1.0])))]
    (flown,) = again.poses()
    np.testing.assert_allclose(flown.odom_from_body.translation_m, [3.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("kept", [None, "", "[1, 2]", "{}", "[0, 0, 0, 0, 1, 1, 1]"])
def test_a_restart_in_the_air_without_a_pad_gives_no_pose(tmp_path: Path, kept: str | None) -> None:
    """The air is no pad: no pose is given, and the vehicle lands."""
    if kept is not None:
        (tmp_path / "pad.json").write_text(kept)
    origin, source = _rig(tmp_path, armed=True)
    source.waiting = [_pose(k / 15, SOURCE_FROM_PAD) for k in range(30)]
    assert origin.poses() == []


def test_the_next_flight_begins_where_the_vehicle_stands_then(tmp_path: Path) -> None:
    origin, source = _rig(tmp_path)
    source.waiting = [_pose(k / 15, SOURCE_FROM_PAD) for k in range(12)]
    assert origin.poses()
    origin, source = _rig(tmp_path)
    elsewhere = Pose.from_yaw(-1.0, np.array([7.0, 7.0, 0.0]))
    source.waiting = [_pose(k / 15, elsewhere) for k in range(12)]
    np.testing.assert_allclose(origin.poses()[-1].odom_from_body.translation_m, 0.0, atol=1e-6)
