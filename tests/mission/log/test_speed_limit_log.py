"""The log of a reduced speed has one line for each change of its reason."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from uav_recon.mission.log.speed_limit_log import SpeedLimitLog
from uav_recon.recording.flight_log import FlightLog, SpeedLimitRecord, read_timeline
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState


def vehicle(stamp_s: float, reason: Reason | None) -> VehicleState:
    return VehicleState(
        stamp_s, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, 0.8, False, math.nan, 1, 0, None,
        max_speed_mps=math.inf if reason is None else 0.3, slow_reason=reason,
    )  # fmt: skip


def logged(folder: Path, *reasons: tuple[float, Reason | None]) -> list[SpeedLimitRecord]:
    journal = FlightLog(folder)
    log = SpeedLimitLog(journal)
    for stamp_s, reason in reasons:
        log.update(vehicle(stamp_s, reason))
    journal.close()
    return list(read_timeline(folder).speed_limits)


def test_each_change_is_a_line(tmp_path: Path) -> None:
    few = [Reason(ReasonCode.FEW_POSES, (rate_hz,)) for rate_hz in (7.0, 6.0)]
    found = logged(tmp_path, (1.0, None), (2.0, few[0]), (4.0, few[1]), (6.0, Reason(ReasonCode.NO_IMU)), (8.0, None))
    assert [(line.stamp_s, line.codes) for line in found] == [(2.0, ("few-poses",)), (6.0, ("no-imu",)), (8.0, ())]
    assert found[0] == SpeedLimitRecord(2.0, 0.3, "7 poses a second", ("few-poses",))


def test_reasons_that_alternate_are_at_most_a_line_a_second(tmp_path: Path) -> None:
    found = logged(tmp_path, *((k / 10, Reason(ReasonCode.NO_IMU) if k % 2 else None) for k in range(100)))
    assert 8 <= len(found) <= 10
