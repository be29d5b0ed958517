from __future__ import annotations

import numpy as np

from uav_recon.localization.exclusion.motion_comparison import MotionComparison
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

ALL = np.eye(3)
TURNED = Pose.from_yaw(2.0, np.array([3.0, -1.0, 0.2]))  # from the first track's frame to the second's


def true_pose(stamp_s: float) -> Pose:
    """Return the pose of a body that flies a circle of 1 m at 0.5 m/s and turns."""
    return Pose.from_yaw(0.3 * stamp_s, np.array([np.cos(0.5 * stamp_s), np.sin(0.5 * stamp_s), 1.0 + 0.02 * np.sin(stamp_s)]))


def compare(frozen_s: float, until_s: float, shown: FloatArray = ALL, noise_m: float = 0.002) -> list[tuple[float, float]]:
    """Return instants and excesses of a first track that stands still from an instant on."""
    comparison, rng, found = MotionComparison(), np.random.default_rng(3), []
    for n in range(round(until_s * 60)):
        now_s = n / 60
        if n % 4 == 0:
            said = true_pose(min(now_s, frozen_s))
            said = Pose(true_pose(now_s).quat_wxyz, said.translation_m + rng.normal(0.0, noise_m, 3))
            comparison.add_first(now_s, said)
        if n % 10 == 3:
            seen = TURNED @ true_pose(now_s)
            seen = Pose(seen.quat_wxyz, seen.translation_m + rng.normal(0.0, 0.003, 3))
            comparison.add_second(now_s, seen, shown)
        found.append((now_s, comparison.excess))
    return found


def test_honest_tracks_in_different_frames_agree() -> None:
    assert max(excess for _, excess in compare(1e9, 20.0)) < 0.7


def test_a_noisy_honest_track_agrees() -> None:
    late = [excess for now_s, excess in compare(1e9, 20.0, noise_m=0.02) if now_s > 3.0]
    assert max(late) < 1.0


def test_a_track_that_stands_still_is_found_within_half_a_second() -> None:
    found = compare(8.0, 9.0)
    assert max(excess for now_s, excess in found if now_s <= 8.0) < 0.7
    assert min(now_s for now_s, excess in found if excess > 1.0) < 8.5


def test_a_direction_that_the_view_does_not_show_is_not_compared() -> None:
    assert max(excess for _, excess in compare(8.0, 9.5, shown=np.diag([0.0, 0.0, 1.0]))) < 1.0


def test_a_slow_drift_shows_over_eight_seconds() -> None:
    def drift_excess(drift_mps: float, shown: FloatArray = ALL) -> float:
        comparison, found = MotionComparison(), [0.0]
        for n in range(round(12.0 * 60)):
            now_s = n / 60
            if n % 4 == 0:
                true = true_pose(now_s)
                comparison.add_first(now_s, Pose(true.quat_wxyz, true.translation_m + drift_mps * now_s * np.eye(3)[0]))
            if n % 10 == 3:
                comparison.add_second(now_s, TURNED @ true_pose(now_s), shown if n == 333 else ALL)
                found.append(comparison.drift_excess)
        assert comparison.excess < 1.0
        return max(found)

    assert drift_excess(0.05) > 1.0
    assert drift_excess(0.02) < 0.7
    assert drift_excess(0.05, shown=0.7 * ALL) > 1.0
    assert drift_excess(0.045) > 1.0
    assert drift_excess(0.045, shown=0.1 * ALL) < 1.0, "a view that lost its place for a moment"


def test_a_gap_is_not_compared_across() -> None:
    comparison = MotionComparison()
    comparison.add_first(0.0, Pose.identity())
    comparison.add_second(0.5, Pose.identity(), ALL)
    assert not comparison.add_first(1.0, Pose.identity())


def test_a_pose_that_is_not_newer_changes_nothing() -> None:
    comparison = MotionComparison()
    comparison.add_first(1.0, Pose.identity())
    assert not comparison.add_first(1.0, Pose.from_yaw(1.0, np.ones(3)))
    assert not comparison.add_first(0.5, Pose.from_yaw(1.0, np.ones(3)))


def test_a_pose_that_is_given_again_is_compared_once() -> None:
    """The newest pose of the view is shown a hundred times a second."""
    comparison = MotionComparison()
    comparison.add_first(0.0, Pose.identity())
    comparison.add_first(0.2, Pose.identity())
    assert comparison.add_second(0.1, Pose.identity(), ALL)
    assert not comparison.add_second(0.1, Pose.identity(), ALL)
