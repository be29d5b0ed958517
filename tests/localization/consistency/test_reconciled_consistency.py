"""A fault is what neither the tracker's map nor the source's odometry explains."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uav_recon.localization.consistency.depth_consistency import CorrectedDrift
from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

WRONG = Reason(ReasonCode.DEPTH_FRAME_CONTRADICTS)
LENS = Intrinsics.from_fov(8, 6, 1.5, 1.0)
FRAME = Frame(1.0, 1, np.ones((6, 8), np.float32), LENS, np.zeros((6, 8, 3), np.uint8), LENS, Pose.identity())
IN_MAP = CameraMotion.at_rest(Pose.identity())
IN_ODOM = CameraMotion.at_rest(Pose.from_yaw(0.0, np.array([0.2, 0.0, 0.0])))


@pytest.mark.parametrize("map_says", [None, WRONG])
@pytest.mark.parametrize("odom_says", [None, WRONG])
def test_both_must_say_so(monkeypatch: pytest.MonkeyPatch, map_says: Reason | None, odom_says: Reason | None) -> None:
    both = ReconciledConsistency()
    asked: list[CameraMotion | None] = []

    def answer(says: Reason | None) -> Callable[..., Reason | None]:
        def rejection(frame: Frame, motion: CameraMotion | None, *rest: object) -> Reason | None:
            asked.append(motion)
            return says

        return rejection

    for monitor, says in ((both._mapped, map_says), (both._plain, odom_says)):
        monkeypatch.setattr(monitor, "rejection", answer(says))
        monkeypatch.setattr(monitor, "drift", lambda now_s, says=says: says)
    sure = map_says is not None and odom_says is not None
    assert both.rejection(FRAME, IN_MAP, 0, CorrectedDrift(IN_ODOM, np.zeros(3))) is (WRONG if sure else None)
    assert asked == [IN_MAP, IN_ODOM]
    assert both.drift(1.0) is (WRONG if sure else None)


def test_both_take_odom_as_valid_up_to_an_instant(monkeypatch: pytest.MonkeyPatch) -> None:
    both, held_s = ReconciledConsistency(), list[float]()
    for monitor in (both._mapped, both._plain):
        monkeypatch.setattr(monitor, "hold_valid", held_s.append)
    both.hold_valid(3.0)
    assert held_s == [3.0, 3.0]
