"""Rows of the table on flights that never were: what a row is there for breaks one of its own bars, by name."""

from __future__ import annotations

import numpy as np
from fault_evidence import evidence, rewired

from sitl.faults.evidence import Evidence
from sitl.faults.table import ROWS


def broken(row: str, e: Evidence) -> set[str]:
    """Names of a row's bars that such a flight does not hold."""
    return {bar.name for bar in ROWS[row].bars if not bar.holds(bar.measure(e), "px4")}


def test_odometry_that_takes_up_a_jump_slowly_breaks_b4() -> None:
    e = evidence()
    taken_m = np.clip(0.1 * (e.wire.odometry_s - 6.0), 0.0, 0.5)
    assert broken("B4", e) == set()
    assert broken("B4", rewired(e, odometry_m=e.wire.odometry_m + taken_m[:, None] * (1, 0, 0))) == {"motion of the error"}
