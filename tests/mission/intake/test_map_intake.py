"""The mission's map takes each frame, cone and correction once, and only those of its own epoch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk, posed_frame

from uav_recon.mission.intake.map_intake import MapIntake
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.pose import MapCorrection


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


@pytest.fixture()
def track() -> FlightTrack:
    return FlightTrack(0.0)


@pytest.fixture()
def maps(desk: Desk, track: FlightTrack) -> MapIntake:
    return MapIntake(desk.stages, desk.channels, desk.parameters, track)


def test_a_frame_is_integrated_once(desk: Desk, maps: MapIntake) -> None:
    assert maps.integrate_frame(10.0) is None and desk.voxels.revision == 0
    desk.channels.frames.publish(posed_frame(10.9))
    posed = maps.integrate_frame(11.0)
    assert posed is not None and posed.frame.stamp_s == 10.9
    assert maps.integrate_frame(12.0) is None
    assert maps.map is not None and maps.map.revision == desk.voxels.revision == 1
    assert maps.frame_s == 11.0


def test_a_frame_of_an_uncertain_place_counts_as_a_frame_but_not_for_the_map(desk: Desk, maps: MapIntake) -> None:
    desk.channels.frames.publish(posed_frame(10.9, unsure=True))
    assert maps.integrate_frame(11.0) is None and maps.map is None
    assert maps.frame_s == 11.0


def test_a_frame_of_another_epoch_counts_for_nothing(desk: Desk, maps: MapIntake) -> None:
    desk.channels.frames.publish(posed_frame(10.9, map_epoch=1))
    assert maps.integrate_frame(11.0) is None and maps.map is None
    assert maps.frame_s == -np.inf


def test_a_correction_begins_an_epoch_in_which_the_flown_path_is_free(desk: Desk, maps: MapIntake, track: FlightTrack) -> None:
    assert not maps.rebuild_corrected()
    track.breadcrumbs.append(np.array([1.0, 0.0, 1.1]))
    desk.channels.correction.publish(MapCorrection(1, np.zeros(0), ()))
    assert maps.rebuild_corrected()
    assert not maps.rebuild_corrected()
    assert [correction.map_epoch for correction in desk.mapper.corrections] == [1]
    assert maps.map_epoch == desk.voxels.epoch == 1
    assert maps.map is not None and maps.map.map_epoch == 1
    assert desk.voxels.declared == pytest.approx((0.3, 1.0, 1.2))


def test_a_cone_needs_a_map_of_its_epoch(desk: Desk, maps: MapIntake) -> None:
    cones = [FreeCone(11.0 + k, epoch, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.2, 1.0) for k, epoch in enumerate((0, 1, 0))]
    desk.channels.cones.publish(cones[0])
    maps.integrate_cone()
    desk.channels.frames.publish(posed_frame(10.9))
    maps.integrate_frame(11.0)
    for cone in cones[1:]:
        desk.channels.cones.publish(cone)
        maps.integrate_cone()
        maps.integrate_cone()
    assert [cone.stamp_s for cone in desk.voxels.cones] == [13.0]
    assert maps.map is not None and maps.map.revision == 2
