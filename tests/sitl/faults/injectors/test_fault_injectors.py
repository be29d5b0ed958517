"""Each fault does what its name says, from its moment on, and nothing before."""

from __future__ import annotations

import dataclasses
import math
import random
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sitl.apps.direct_channels import DirectChannel
from sitl.apps.lockstep import HookedExecutor, NoHook
from sitl.camera.d435i import FAST_DEPTH_SPEC
from sitl.faults.fault_director import off_nose_rad
from sitl.faults.injectors import depth_camera, pose_stream
from sitl.faults.injectors.base import DepthFrame, InjectionContext, Injector
from sitl.faults.injectors.companion import Crash, Stall
from sitl.faults.injectors.mavlink_link import GCS, GENERIC, INVALID, QUADROTOR, ProgramHeartbeats
from sitl.faults.injectors.obstacle import Obstacle, RendererWithObstacle
from sitl.faults.injectors.vehicle_and_autopilot import HeightDatumMoved, VerticalVelocityError
from sitl.faults.judges.map_integrity import AGAIN, CLAIMED, FREED, SETTLED_S, UNDER_WAY_S, Claims, MapIntegrityCheck, Tally
from sitl.faults.table.all_scenarios import SCENARIOS, TABLE
from sitl.geometry.quaternion import yaw_of
from sitl.geometry.transform import body_from_camera
from sitl.scene.mesh import joined
from sitl.scene.primitives import MeshBuilder
from sitl.scene.rasterizer import Renderer
from sitl.scene.texture import plain
from sitl.world.pose_tracker import PoseRecord
from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, FreeSpace, GridSpec, VoxelMap


def record(stamp_s: float = 10.0) -> PoseRecord:
    return PoseRecord(stamp_s, np.array([1.0, 2.0, 1.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4), 100, 0)


def frame(stamp_s: float = 10.0) -> DepthFrame:
    return DepthFrame(stamp_s, np.full((4, 6), 2000, np.uint16), np.zeros((2, 3, 3), np.uint8))


def one(injector: Injector, since_s: float = 0.0) -> PoseRecord:
    late = injector.pose(since_s, record())
    assert len(late) == 1
    return late[0][1]


def test_poses_stop_and_come_back() -> None:
    silence = pose_stream.PoseSilence(0.5)
    assert silence.pose(0.4, record()) == []
    assert len(silence.pose(0.6, record())) == 1


def test_a_spike_is_one_pose() -> None:
    spike = pose_stream.AlteredPoses(pose_stream.moved(x=0.5), count=1)
    assert one(spike).position_m[0] == pytest.approx(1.5)
    assert one(spike).position_m[0] == pytest.approx(1.0)


def test_drift_grows_and_ends() -> None:
    drift = pose_stream.AlteredPoses(pose_stream.drifting(0.05, 0.0, max_m=3.0))
    assert one(drift, 10.0).position_m[0] == pytest.approx(1.5)
    assert one(drift, 1000.0).position_m[0] == pytest.approx(4.0)


def test_a_heading_flips() -> None:
    w, x, y, z = one(pose_stream.AlteredPoses(pose_stream.turned(90.0))).quat_wxyz
    assert yaw_of((w, x, y, z)) == pytest.approx(math.pi / 2)
    moved = one(pose_stream.AlteredPoses(pose_stream.map_turned(90.0)))
    np.testing.assert_allclose(moved.position_m, [-2.0, 1.0, 1.0], atol=1e-9)


def test_a_source_with_another_origin_turns_about_the_pad() -> None:
    """The pad itself, and what is a metre ahead of it and two to the left, as the source sees them."""
    change = pose_stream.other_origin(yaw_deg=90.0, x=2.0, z=0.3)
    pad = dataclasses.replace(record(), position_m=np.zeros(3))
    np.testing.assert_allclose(change(pad, 0.0).position_m, [2.0, 0.0, 0.3], atol=1e-9)
    seen = change(record(), 0.0)
    np.testing.assert_allclose(seen.position_m, [0.0, 1.0, 1.3], atol=1e-9)
    w, x, y, z = seen.quat_wxyz
    assert yaw_of((w, x, y, z)) == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("kind", ["nan place", "inf place", "nan turn", "zero turn", "long turn", "nan variance", "nan stamp"])
def test_what_makes_no_sense_makes_none(kind: str) -> None:
    bad = one(pose_stream.AlteredPoses(pose_stream.invalid(kind)))
    numbers = np.concatenate([[bad.stamp_s], bad.position_m, bad.quat_wxyz, bad.variance])
    assert not np.isfinite(numbers).all() or abs(np.linalg.norm(bad.quat_wxyz) - 1.0) > 0.5


def test_stamps_and_rates() -> None:
    frozen = pose_stream.FrozenPose()
    assert [late[0][1].stamp_s for late in (frozen.pose(0.0, record(10.0)), frozen.pose(0.1, record(11.0)))] == [10.0, 10.0]
    assert one(pose_stream.AlteredPoses(pose_stream.stamped(5.0))).stamp_s == 15.0
    assert pose_stream.LatePoses(0.3).pose(0.0, record())[0][0] == 0.3
    thinned = pose_stream.ThinnedPoses(3.0)
    assert sum(len(thinned.pose(k / 30.0, record())) for k in range(300)) == pytest.approx(30, abs=2)


def test_frames_are_lost_repeated_and_late() -> None:
    assert depth_camera.DepthSilence(0.3).depth(0.2, frame()) == []
    assert depth_camera.LateFrames(0.5).depth(0.0, frame())[0][0] == 0.5
    assert len(depth_camera.ReorderedFrames().depth(0.0, frame())) == 2
    single = depth_camera.SingleFrames(depth_camera.constant(0), 3.0)
    emptied = [not single.depth(n / 6, frame())[0][1].depth_mm.any() for n in range(60)]
    assert [n for n, empty in enumerate(emptied) if empty] == [0, 18, 36, 54]
    scattered = depth_camera.ScatteredFrames(depth_camera.constant(0), 0.15, seed=3)
    assert 100 <= sum(not scattered.depth(n / 6, frame())[0][1].depth_mm.any() for n in range(1000)) <= 200
    redated = depth_camera.ShiftedTimestamps(-3600.0, 1.0)
    assert [redated.depth(since_s, frame(5000.0))[0][1].stamp_s for since_s in (0.0, 0.9, 1.0)] == [1400.0, 1400.0, 5000.0]
    hung = depth_camera.FrozenImage()
    first = hung.depth(0.0, frame(1.0))[0][1]
    later = DepthFrame(2.0, np.full((4, 6), 500, np.uint16), first.rgb)
    assert (hung.depth(0.1, later)[0][1].depth_mm == first.depth_mm).all()
    assert hung.depth(0.2, later)[0][1].stamp_s == 2.0


def test_a_frame_that_is_mapped_again_is_counted_by_its_picture() -> None:
    frames = DirectChannel[Any]()
    at = InjectionContext(cast("Any", None), dice=random.Random(), channels=SimpleNamespace(frames=frames))
    tally = Tally()
    tally.begin(at)
    for picture in (1.0, None, 2.0, 1.0, 1.0):
        if picture is not None:
            frames.publish(SimpleNamespace(frame=SimpleNamespace(depth_m=np.full((2, 2), picture, np.float32))))
        tally.turn(at, 0.0)
    assert at.notes == {AGAIN: 2.0}


def mapped(*states: int) -> VoxelMap:
    """A row of voxels of a metre."""
    grid = GridSpec(np.zeros(3), 1.0, (len(states), 1, 1))
    state = np.array(states, np.uint8).reshape(grid.shape)
    return VoxelMap.whole(grid, state, np.zeros(grid.shape, np.uint8), 1)


def test_what_becomes_known_as_free_is_counted_once_what_was_under_way_is_mapped() -> None:
    voxels, free = DirectChannel[VoxelMap](), DirectChannel[FreeSpace]()
    world = SimpleNamespace(
        clearance=SimpleNamespace(bins=SimpleNamespace(points=np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])))
    )
    at = InjectionContext(cast("Any", world), dice=random.Random(), channels=SimpleNamespace(voxels=voxels, free=free))
    walls, claims = MapIntegrityCheck(), Claims()

    def shows(*states: int) -> None:
        voxels.publish(mapped(*states))
        free.publish(FreeSpace.of(mapped(*states)))

    shows(OCCUPIED, OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN, FREE)
    walls.begin(at)
    claims.turn(at, SETTLED_S - 0.1)
    walls.turn(at, UNDER_WAY_S - 0.1)
    shows(OCCUPIED, OCCUPIED, OCCUPIED, FREE, UNKNOWN, FREE)  # of a frame from before
    claims.turn(at, SETTLED_S)
    walls.turn(at, UNDER_WAY_S)
    for injector in (walls, claims):
        injector.end(at)
    assert at.notes == {FREED: 0.0, CLAIMED: 0.0}
    shows(OCCUPIED, FREE, FREE, FREE, FREE, UNKNOWN)
    for injector in (walls, claims):
        injector.end(at)
    assert at.notes == {FREED: 50.0, CLAIMED: 3.0}, "the third is no wall"


def test_what_a_frame_of_before_frees_is_no_damage() -> None:
    voxels, free = DirectChannel[VoxelMap](), DirectChannel[FreeSpace]()
    points = np.array([[k + 0.5, 0.5, 0.5] for k in range(3)])
    world = SimpleNamespace(clearance=SimpleNamespace(bins=SimpleNamespace(points=points)))
    at = InjectionContext(cast("Any", world), dice=random.Random(), channels=SimpleNamespace(voxels=voxels, free=free))
    walls = MapIntegrityCheck()
    voxels.publish(mapped(OCCUPIED, OCCUPIED, OCCUPIED))
    walls.begin(at)
    free.publish(FreeSpace.of(mapped(FREE, OCCUPIED, OCCUPIED)))
    walls.turn(at, UNDER_WAY_S)
    free.publish(FreeSpace.of(mapped(FREE, FREE, OCCUPIED)))
    walls.turn(at, UNDER_WAY_S + 0.1)
    voxels.publish(mapped(FREE, FREE, OCCUPIED))
    walls.end(at)
    assert at.notes == {FREED: 50.0}, "one of two: the first was gone before"


def test_a_flight_that_never_settled_claims_nothing_and_so_holds_no_bar() -> None:
    at = InjectionContext(cast("Any", None), dice=random.Random(), channels=SimpleNamespace(free=DirectChannel[FreeSpace]()))
    claims = Claims()
    claims.turn(at, 1.0)
    claims.end(at)
    assert at.notes == {}


@pytest.mark.parametrize(
    "change",
    [
        depth_camera.constant(0),
        depth_camera.constant(65535),
        depth_camera.salted(0.3),
        depth_camera.shifted(2),
        depth_camera.bit_errors(),
        depth_camera.scaled(0.5),
    ],
)
def test_pictures_are_spoilt(change: depth_camera.Change) -> None:
    depth = np.arange(400, 400 + 24 * 50, 50).reshape(4, 6).astype(np.uint16)
    changed = depth_camera.AlteredDepth(change).depth(0.0, DepthFrame(0.0, depth, None))[0][1].depth_mm
    assert changed.dtype == np.uint16
    assert changed.shape == depth.shape
    assert (changed != depth).any()


def test_stages_stall_and_crash() -> None:
    stall = Stall("mission", for_s=5.0)
    assert stall.stalls(4.9, "mission")
    assert not stall.stalls(4.9, "pilot")
    assert not stall.stalls(5.1, "mission")
    crash = Crash("pilot", back_s=1.0)
    assert crash.stalls(0.5, "pilot")
    assert not crash.restarts(0.5, "pilot")
    assert [crash.restarts(1.0, "pilot"), crash.restarts(1.1, "pilot")] == [True, False]


def test_a_call_of_the_planner_hangs_while_the_mission_runs() -> None:
    hung, clock = Stall("planner"), ManualClock(0.0)

    class Hung(NoHook):
        def runs(self, stage: str) -> bool:
            return not hung.stalls(clock.now_s(), stage)

    free, stuck = (HookedExecutor(InlineExecutor(clock), director).submit(lambda: 7, 0.1) for director in (NoHook(), Hung()))
    assert not free.done()
    clock.advance_to(1.0)
    assert free.done() and free.result() == 7
    assert not stuck.done()
    assert Hung().runs("mission")
    assert SCENARIOS["A2h"].flown(live=False)


def test_an_obstacle_is_seen_and_felt() -> None:
    wall = joined([MeshBuilder(fine=False).patch((4, -5, -5), (0, 10, 0), (0, 0, 10), plain((0.5, 0.5, 0.5)))])
    scene = Renderer(wall.vertices, wall.faces, wall.rgb)
    box = Obstacle(3.0, (0.5, 0.5, 0.5), lambda now_s: (2.5, 0.0, 0.0))
    pose = body_from_camera((0.0, 0.0, 0.0), 0.0)
    v, u = FAST_DEPTH_SPEC.height // 2, FAST_DEPTH_SPEC.width // 2
    both = RendererWithObstacle(scene, box, lambda: 5.0).render(pose, FAST_DEPTH_SPEC, colour=False).depth_m
    assert scene.render(pose, FAST_DEPTH_SPEC, colour=False).depth_m[v, u] == pytest.approx(4.0, abs=0.01)
    assert both[v, u] == pytest.approx(2.0, abs=0.01)
    assert both[v, 2] == pytest.approx(4.0, abs=0.01)
    gaps = box.hull_m(np.array([2.0, 4.0, 5.0, 5.0]), np.array([[0, 0, 0], [0, 0, 0], [1.8, 0, 0], [2.5, 0.0, 1.0]]), 0.2)
    np.testing.assert_allclose(gaps, [math.inf, 1.8, 0.0, 0.4], atol=1e-9)


def test_every_row_can_be_flown_or_says_why() -> None:
    assert len({scenario.id for scenario in TABLE}) == len(TABLE)
    for scenario in TABLE:
        assert (scenario.flown(live=False) or scenario.flown(live=True)) == bool(scenario.limits), scenario.id
        assert scenario.flown(live=False) != bool(scenario.why), scenario.id
        for number in range(9):
            list(scenario.injectors(number))


def test_what_appears_ahead_appears_where_the_camera_looks() -> None:
    half = math.sqrt(0.5)
    assert off_nose_rad((1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)) == pytest.approx(0.0)
    assert off_nose_rad((0.0, 1.0, 0.0), (half, 0.0, 0.0, half)) == pytest.approx(0.0)
    assert off_nose_rad((1.0, 0.0, 0.0), (half, 0.0, 0.0, half)) == pytest.approx(math.pi / 2)
    assert off_nose_rad((-1.0, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0)) == pytest.approx(math.pi)
    assert SCENARIOS["C8"].onset.needs_view_ahead


class Estimator:
    """What a fault changes of an estimator."""

    velocity_error = (0.0, 0.0, 0.0)
    moved_m = 0.0

    def move_height_datum(self, up_m: float) -> None:
        self.moved_m += up_m


def test_an_estimators_vertical_velocity_is_off_in_the_air_only_and_its_datum_moves_once() -> None:
    estimator, vehicle = Estimator(), SimpleNamespace(on_ground=False)
    autopilot = SimpleNamespace(estimator=estimator, vehicle=vehicle, truth=lambda: SimpleNamespace(armed=True))
    at: Any = SimpleNamespace(world=SimpleNamespace(autopilot=autopilot))
    fault = VerticalVelocityError(0.5)
    fault.turn(at, 0.0)
    assert estimator.velocity_error == (0.0, 0.0, -0.5)
    vehicle.on_ground = True
    fault.turn(at, 1.0)
    assert estimator.velocity_error == (0.0, 0.0, 0.0)
    datum = HeightDatumMoved(-0.5)
    datum.begin(at)
    datum.turn(at, 1.0)
    assert estimator.moved_m == -0.5


@pytest.mark.parametrize("to_autopilot", [True, False])
def test_other_programs_send_once_a_second_with_numbers_of_their_own(to_autopilot: bool) -> None:
    sent: dict[str, list[bytes]] = {"autopilot": [], "product": []}
    proxy = SimpleNamespace(inject_to_autopilot=sent["autopilot"].append, inject_to_product=sent["product"].append)
    at: Any = SimpleNamespace(proxy=proxy)
    fault = ProgramHeartbeats((245, 190, GCS, INVALID), (1, 1, QUADROTOR, GENERIC), to_autopilot=to_autopilot)
    for turn in range(250):
        fault.turn(at, turn * 0.01)
    assert not sent["product" if to_autopilot else "autopilot"]
    frames = sent["autopilot" if to_autopilot else "product"]
    numbered = [(245, 190, n) if n < 50 else (1, 1, n) for n in (0, 50, 1, 51, 2, 52)]
    assert [(frame[5], frame[6], frame[4]) for frame in frames] == numbered
    with_states = ProgramHeartbeats((1, 1, GCS, INVALID), states=True)
    sent["product"].clear()
    with_states.turn(at, 0.0)
    assert [frame[7] for frame in sent["product"]] == [0, 1, 32]
