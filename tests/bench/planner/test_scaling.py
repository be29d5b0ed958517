from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uav_recon.bench.planner import builtin_building, scaling
from uav_recon.bench.planner.stages import WHOLE


def test_copies_are_arranged_in_a_block() -> None:
    assert [scaling.layout(copies) for copies in (1, 10, 100)] == [(1, 1), (5, 2), (10, 10)]


def test_the_building_is_copied_as_requested_and_every_frame_is_planned() -> None:
    whole = builtin_building.fly_through()
    recording = replace(whole, frames=whole.frames[:24])
    ticks: list[int] = []
    sizes = [scaling.measure(recording, copies, ticks.append) for copies in (1, 2)]
    assert sum(ticks) == scaling.ticks(recording, 1) + scaling.ticks(recording, 2)
    assert sizes[0].area_m2 == pytest.approx(10.4 * 6.4)
    assert sizes[1].area_m2 == pytest.approx(2 * sizes[0].area_m2)
    assert sizes[1].voxels == (208, 64, 30)
    for size in sizes:
        assert set(size.stages) == set(WHOLE)
        assert size.stages["total"].median_ms > 0
        assert np.isfinite(size.memory_mb)
