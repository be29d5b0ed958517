"""A state of the vehicle reaches the track, both motion planners, the log of the speed limit and the battery policy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk, vehicle_state

from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.intake.vehicle_intake import VehicleIntake
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


def test_a_state_is_recorded_everywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    desk, track, allowed = Desk(tmp_path), FlightTrack(0.0), list[tuple[str, float]]()
    monkeypatch.setattr(desk.stages.motion, "set_max_speed", lambda speed_mps: allowed.append(("motion", speed_mps)))
    monkeypatch.setattr(desk.stages.retreat, "set_max_speed", lambda speed_mps: allowed.append(("retreat", speed_mps)))
    battery = BatteryPolicy(track, np.zeros(3), 0.35)
    vehicle = vehicle_state(10.0, x_m=1.5, max_speed_mps=0.4, slow_reason=Reason(ReasonCode.NO_IMU))
    VehicleIntake(desk.stages, track, battery, desk.journal).update(10.0, vehicle, None)
    desk.journal.close()
    assert track.position_world.tolist() == [1.5, 0.0, 0.0]
    assert allowed == [("motion", 0.4), ("retreat", 0.4)]
    assert battery.left == pytest.approx(0.9)
    assert [limit.codes for limit in read_timeline(tmp_path).speed_limits] == [(ReasonCode.NO_IMU,)]
