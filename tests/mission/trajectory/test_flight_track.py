"""Breadcrumbs lead back without the loops that were flown."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from uav_recon.mission.trajectory.flight_track import BREADCRUMB_M, FlightTrack
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Trajectory
from uav_recon.types.vehicle import FlightPhase, VehicleState


def vehicle_at(x: float, y: float, z: float = 1.0, *, armed: bool = True, yaw_rad: float = 0.0) -> VehicleState:
    pose = Pose.from_yaw(yaw_rad, np.array([x, y, z]))
    return VehicleState(0.0, pose, np.zeros(3), armed, "OFFBOARD", FlightPhase.FLYING, 1.0, False, 0.0, -1, 0, None)


def test_a_hold_is_where_the_pilot_brings_it_to_rest() -> None:
    track, vehicle = FlightTrack(0.2), vehicle_at(1.0, 0.0)
    assert track.hold_here(vehicle).position_m.tolist() == [1.0, 0.0, 1.0]
    stopped = dataclasses.replace(vehicle, world_from_rest=Pose.from_yaw(0.5, np.array([1.3, 0.1, 1.0])))
    held = track.hold_here(stopped)
    assert held.position_m.tolist() == [1.3, 0.1, 1.0]
    assert held.yaw_rad == pytest.approx(0.5)
    assert held.camera_pitch_down_rad == 0.2


def test_path_length_counts_only_flight() -> None:
    track = FlightTrack(0.0)
    track.follow(vehicle_at(0.0, 0.0, armed=False))
    track.follow(vehicle_at(5.0, 0.0, armed=False))
    track.follow(vehicle_at(6.0, 0.0))
    track.follow(vehicle_at(6.0, 2.0))
    assert track.path_length_m == 3.0


@pytest.mark.parametrize(
    ("x", "yaw_rad", "followed"), [(0.9, 0.0, True), (0.4, 0.0, False), (1.0, 0.5, True), (1.0, -0.7, False), (1.0, 6.2, True)]
)
def test_a_vehicle_follows_where_it_is_about_there_and_looks_that_way(x: float, yaw_rad: float, followed: bool) -> None:
    track = FlightTrack(0.0)
    track.follow(vehicle_at(x, 0.0, yaw_rad=yaw_rad))
    assert not track.is_on_track(10.0), "nothing is flown"
    places, still, flat = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]]), np.zeros((2, 3)), np.zeros(2)
    track.trajectory = Trajectory(10.0, 2.0, places, still, still, flat, flat, flat, np.zeros(0), 0, 1)
    assert track.is_on_track(11.0) is followed


def test_the_way_back_leaves_out_the_climb_from_the_pad() -> None:
    track = FlightTrack(0.0)
    for z in np.arange(0.1, 1.15, 0.05):
        track.follow(vehicle_at(0.0, 0.0, z))
    for x in np.arange(0.0, 2.0, 0.05):
        track.follow(vehicle_at(x, 0.0, 1.1))
    back = np.array(track.way_back(np.array([0.0, 0.0, 1.1])))
    assert back[:, 2].min() > 1.1 - 1.5 * BREADCRUMB_M - 1e-9
    assert back[0, 0] > 1.7
    assert np.linalg.norm(back[-1] - (0.0, 0.0, 1.1)) < 1.5 * BREADCRUMB_M + 1e-9


def test_the_way_back_cuts_loops_and_ends_at_the_start() -> None:
    track = FlightTrack(0.0)
    circle = [(1 + np.sin(a), 1 - np.cos(a)) for a in np.linspace(0, 2 * np.pi, 60)]
    for x, y in [*[(0.05 * i, 0.0) for i in range(20)], *circle, *[(1 + 0.05 * i, 0.0) for i in range(20)]]:
        track.follow(vehicle_at(x, y))
    back = np.array(track.way_back(np.array([0.0, 0.0, 1.0])))
    steps = np.linalg.norm(np.diff(back, axis=0), axis=1)
    assert np.linalg.norm(back[-1][:2]) < 1e-9
    assert steps.max() <= 1.5 * BREADCRUMB_M + 1e-9
    assert steps.sum() < 2.5  # the circle of 6.3 m is not flown again


def test_the_way_back_is_that_of_plain_loops_over_all_pairs() -> None:
    rng = np.random.default_rng(5)
    track, here = FlightTrack(0.0), np.array([0.0, 0.0, 1.0])
    for goal in rng.uniform((-4.0, -4.0, 0.6), (4.0, 4.0, 1.8), (12, 3)):
        for share in np.linspace(0.0, 1.0, 40):
            track.follow(vehicle_at(*(here + share * (goal - here))))
        here = goal
    home, reach_m = np.array([0.0, 0.0, 1.0]), 1.5 * BREADCRUMB_M
    crumbs = track.breadcrumbs[::-1]
    crumbs = crumbs[: 1 + max(i for i, crumb in enumerate(crumbs) if np.linalg.norm(crumb - home) <= reach_m)]
    way, i = [], 0
    while i < len(crumbs):
        way.append(crumbs[i])
        i = max((j for j in range(i + 1, len(crumbs)) if np.linalg.norm(crumbs[j] - crumbs[i]) <= reach_m), default=i + 1)
    assert 10 < len(way) < len(crumbs)
    np.testing.assert_array_equal(track.way_back(home), way)
