from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.fusion.error_release import ErrorRelease


def test_nothing_is_left_before_an_error_is_found() -> None:
    assert not ErrorRelease().left_m(5.0).any()


def test_an_error_leaves_at_a_bounded_speed_and_ends() -> None:
    release = ErrorRelease()
    release.begin(10.0, np.array([0.0, -0.3, 0.0]))
    assert not release.left_m(9.9).any()
    np.testing.assert_allclose(release.left_m(10.0), [0.0, -0.3, 0.0])
    np.testing.assert_allclose(release.left_m(10.5), [0.0, -0.15, 0.0])
    assert not release.left_m(11.0).any()
    lengths = [float(np.linalg.norm(release.left_m(10.0 + 0.01 * n))) for n in range(120)]
    assert max(np.abs(np.diff(lengths))) == pytest.approx(0.003)


def test_a_new_error_replaces_what_was_left() -> None:
    release = ErrorRelease()
    release.begin(10.0, np.array([0.3, 0.0, 0.0]))
    release.begin(10.5, np.array([0.0, 0.0, 0.1]))
    np.testing.assert_allclose(release.left_m(10.5), [0.0, 0.0, 0.1])
