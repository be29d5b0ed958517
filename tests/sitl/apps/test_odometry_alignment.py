from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sitl.apps.odometry_alignment import align_odometry

STAMP_S = np.arange(0.0, 30.0, 0.02)
PATH_M = np.column_stack((2.0 * np.sin(0.4 * STAMP_S), 1.5 * np.cos(0.3 * STAMP_S), 1.0 + 0.5 * np.sin(0.2 * STAMP_S)))


@settings(max_examples=20, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    shift=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
)
def test_a_rigid_difference_of_the_frames_is_removed(turn: tuple[float, ...], shift: tuple[float, ...]) -> None:
    rotation = Rotation.from_rotvec(turn)
    odom_m = rotation.inv().apply(PATH_M - np.array(shift))  # truth = R odom + shift
    found = align_odometry(STAMP_S[::25], odom_m[::25], STAMP_S, PATH_M)
    assert found is not None
    assert found.ate_m < 1e-9
    np.testing.assert_allclose(found.truth_from_odom.rotation(), rotation.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(found.truth_from_odom.translation_m, shift, atol=1e-9)
    assert found.turn_rad == pytest.approx(rotation.magnitude(), abs=1e-6)


def test_what_no_rigid_motion_explains_is_the_error() -> None:
    noise_m = np.random.default_rng(0).normal(0.0, 0.02, PATH_M.shape)
    found = align_odometry(STAMP_S, PATH_M + noise_m, STAMP_S, PATH_M)
    assert found is not None
    assert found.ate_m == pytest.approx(0.02 * np.sqrt(3.0), rel=0.05)
    assert found.error_m.max() > 2.0 * found.ate_m


def test_a_path_of_another_clock_is_not_compared() -> None:
    assert align_odometry(STAMP_S + 1000.0, PATH_M, STAMP_S, PATH_M) is None
    assert align_odometry(STAMP_S[:2], PATH_M[:2], STAMP_S, PATH_M) is None
    lost = np.full_like(PATH_M, np.nan)
    assert align_odometry(STAMP_S, lost, STAMP_S, PATH_M) is None
