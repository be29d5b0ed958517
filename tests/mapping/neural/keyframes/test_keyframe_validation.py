from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, look, tour
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes.keyframe_validation import (
    ContradictionVote,
    RejectCounts,
    RejectReason,
    padded_box,
    reject_reason,
)
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

GOOD = look((1.5, 1.2, 1.0), 0.0)
PADDED = padded_box(LOW, HIGH)
STRANGE = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-40, 1e-3, 0.15, 1.0, 8.0, 65.0, 3e38]


def _trainer() -> NeuralMapper:
    return NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)


def _with_lens(view: PosedFrame, **numbers: float) -> PosedFrame:
    lens = dataclasses.replace(view.frame.depth_intrinsics, **numbers)  # type: ignore[arg-type]
    return dataclasses.replace(view, frame=dataclasses.replace(view.frame, depth_intrinsics=lens))


def _with_depth(view: PosedFrame, depth_m: Float32Array) -> PosedFrame:
    return dataclasses.replace(view, frame=dataclasses.replace(view.frame, depth_m=depth_m))


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        ({}, None),
        ({"fx": np.nan}, RejectReason.INTRINSICS),
        ({"fy": np.inf}, RejectReason.INTRINSICS),
        ({"fx": 0.0}, RejectReason.INTRINSICS),
        ({"fy": -50.0}, RejectReason.INTRINSICS),
        ({"cx": 1e6}, RejectReason.INTRINSICS),
        ({"cy": np.nan}, RejectReason.INTRINSICS),
        ({"fx": 5.0}, RejectReason.INTRINSICS),  # a ray record cannot hold such bearings
        ({"fx": 1e6, "fy": 1e6}, RejectReason.INTRINSICS),
        ({"width": 60, "height": 106}, RejectReason.SHAPE),
    ],
)
def test_intrinsics_that_no_camera_has_are_refused(numbers: dict[str, float], reason: RejectReason | None) -> None:
    assert reject_reason(_with_lens(GOOD, **numbers), *PADDED) is reason


def test_an_invalid_pose_is_refused() -> None:
    for name, value in (("translation_m", np.array([np.nan, 1.0, 1.0])), ("quat_wxyz", np.array([1.0, 1.0, 0.0, 0.0]))):
        pose = Pose(GOOD.world_from_depth.quat_wxyz, GOOD.world_from_depth.translation_m)
        object.__setattr__(pose, name, value)
        assert reject_reason(dataclasses.replace(GOOD, world_from_depth=pose), *PADDED) is RejectReason.POSE


@pytest.mark.parametrize("metres", [np.nan, 0.0, -1.0, 0.1, 30.0, np.inf, 3e38])
def test_a_view_without_depth_in_the_range_of_a_ray_is_empty(metres: float) -> None:
    assert reject_reason(_with_depth(GOOD, np.full_like(GOOD.frame.depth_m, metres)), *PADDED) is RejectReason.EMPTY


def test_depth_that_no_ray_samples_is_empty() -> None:
    mapper, depth = _trainer(), np.full((480, 640), np.nan, dtype=np.float32)
    depth[:48, :64] = 1.0
    lens = Intrinsics.from_fov(640, 480, 1.2, 0.9)
    frame = dataclasses.replace(GOOD.frame, depth_m=depth, depth_intrinsics=lens)
    assert mapper.add(dataclasses.replace(GOOD, frame=frame))
    depth = np.full((100, 100), np.nan, dtype=np.float32)
    depth[::10, ::10] = 1.0
    depth[50:, 50:] = np.nan
    frame = dataclasses.replace(GOOD.frame, depth_m=depth, depth_intrinsics=Intrinsics.from_fov(100, 100, 1.2, 0.9))
    assert reject_reason(dataclasses.replace(GOOD, frame=frame), *PADDED) is RejectReason.EMPTY


def test_refusals_are_counted_and_logged_at_powers_of_two(caplog: pytest.LogCaptureFixture) -> None:
    refusals = RejectCounts()
    with caplog.at_level(logging.WARNING):
        for _ in range(9):
            refusals.note(RejectReason.EMPTY)
        refusals.note(RejectReason.POSE)
    assert refusals.counts == {RejectReason.EMPTY: 9, RejectReason.POSE: 1}
    assert refusals.total() == 10
    assert caplog.messages == [
        *(f"a view was refused: no depth ({n} so far)" for n in (1, 2, 4, 8)),
        "a view was refused: the pose is not a finite rotation and place (1 so far)",
    ]


@pytest.fixture(scope="module")
def room() -> NeuralMapper:
    mapper = _trainer()
    for view in tour(12, NOISE_PX):
        assert mapper.add(view)
    return mapper


def _crossing(n: int) -> PosedFrame:
    """Return a view across the room, which shows floor and walls."""
    return look((0.5 + 0.1 * n, 0.4 + 0.2 * n, 1.2), 40.0 + 35.0 * n, 100 + n, NOISE_PX)


def test_a_wrong_focal_length_is_caught_by_what_is_mapped(room: NeuralMapper) -> None:
    lens = GOOD.frame.depth_intrinsics
    for wrong in (
        {"fx": 2.0 * lens.fx, "fy": 2.0 * lens.fy},
        {"fx": 0.5 * lens.fx, "fy": 0.5 * lens.fy},
        {"cx": lens.cy, "cy": lens.cx},
    ):
        taken = sum(room.add(_with_lens(_crossing(n), **wrong)) for n in range(6))
        assert taken <= 1
    assert room.refusals.counts[RejectReason.DISAGREES] >= 9  # most of the rest lies outside the box


def test_correct_views_are_accepted_with_pose_errors_of_2_cm_and_1_degree(room: NeuralMapper) -> None:
    random, refused = np.random.default_rng(5), room.refusals.total()
    for n in range(10):
        view = _crossing(n)
        error = Pose.from_rotation_vector(np.deg2rad(1.0) * random.standard_normal(3), np.zeros(3))
        shift = view.world_from_depth.translation_m + 0.02 * random.standard_normal(3)
        displaced = Pose((error @ view.world_from_depth).quat_wxyz, shift)
        assert room.add(dataclasses.replace(view, world_from_depth=displaced))
    assert room.refusals.total() == refused


def _votes(seen: int, refuted: int) -> Float32Array:
    votes = np.zeros(1000, dtype=np.float32)
    votes[:seen], votes[seen : seen + refuted] = 2.0, -0.5
    return votes


def test_a_contradiction_needs_votes_and_the_lens_is_remembered() -> None:
    doubt, lens, other = (
        ContradictionVote(),
        Intrinsics(50.0, 50.0, 10.0, 10.0, 20, 20),
        Intrinsics(60.0, 50.0, 10.0, 10.0, 20, 20),
    )
    assert not doubt.is_contradiction(lens, _votes(20, 60))  # too few votes
    doubt = ContradictionVote()
    assert not doubt.is_contradiction(lens, _votes(400, 20))
    assert doubt.is_contradiction(lens, _votes(400, 101))  # one bad view: the pose is blamed
    assert not doubt.is_contradiction(lens, _votes(400, 0))
    assert doubt.is_contradiction(other, _votes(200, 200))
    assert doubt.is_contradiction(other, _votes(5, 0))  # a new position, with a lens that is known to be wrong
    assert not doubt.is_contradiction(lens, _votes(5, 0))


_NUMBER = st.one_of(st.sampled_from(STRANGE), st.floats(width=32))
_LENS = st.one_of(
    st.just(GOOD.frame.depth_intrinsics),
    st.builds(
        Intrinsics, st.floats(), st.floats(), st.floats(), st.floats(), st.sampled_from([0, 1, 106]), st.sampled_from([1, 60])
    ),
    st.builds(
        Intrinsics,
        st.floats(10, 500),
        st.floats(10, 500),
        st.floats(-300, 300),
        st.floats(-300, 300),
        st.just(106),
        st.just(60),
    ),
)
_DEPTH = st.one_of(
    st.just(GOOD.frame.depth_m),
    st.builds(lambda z: np.full((60, 106), z, dtype=np.float32), _NUMBER),
    st.builds(
        lambda seed, values: np.random.default_rng(seed).choice(np.array(values, dtype=np.float32), (60, 106)),
        st.integers(0, 1000),
        st.lists(_NUMBER, min_size=1, max_size=6),
    ),
)
_POSE = st.one_of(
    st.just(GOOD.world_from_depth),
    st.builds(
        lambda turn, place: Pose.from_rotation_vector(np.array(turn), np.array(place)),
        st.tuples(*[st.floats(-4.0, 4.0)] * 3),
        st.tuples(st.floats(-0.2, 3.2), st.floats(-0.2, 2.6), st.floats(-0.2, 2.2)),
    ),
)


def test_a_depth_that_overflows_in_millimetres_is_no_return() -> None:
    depth = GOOD.frame.depth_m.copy()
    depth[::2, ::2] = 3e38
    mapper = _trainer()
    assert mapper.add(_with_depth(GOOD, depth))
    assert not mapper.training_data().images.image(0).any()


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(lens=_LENS, colour=_LENS, depth=_DEPTH, pose=_POSE, beside=_POSE, steps=st.integers(0, 3), poison=st.booleans())
def test_the_field_stays_finite_for_any_input(
    lens: Intrinsics, colour: Intrinsics, depth: Float32Array, pose: Pose, beside: Pose, steps: int, poison: bool
) -> None:
    mapper = HOSTILE
    frame = Frame(0.0, 0, depth, lens, GOOD.frame.rgb, colour, beside)
    before, refused = mapper.views, mapper.refusals.total()
    taken = mapper.add(PosedFrame(frame, pose))
    assert (mapper.views, mapper.refusals.total()) == (before + taken, refused + (not taken))
    if poison:  # a gradient that is not finite must not reach the field
        mapper._learner._optimiser.flat_gradient[7] = np.nan
        skipped = mapper.skipped
        mapper.train(1)
        assert mapper.skipped == skipped + (mapper.views > 0)
        mapper._learner._optimiser.flat_gradient[7] = 0.0
    assert np.isfinite(mapper.train(steps))
    assert np.isfinite(mapper.field.parameters).all()
    assert np.isfinite(mapper.field.grid.features).all()
    surface = mapper.surface()
    assert np.isfinite(surface.position_world).all()
    assert np.isfinite(surface.uncertainty).all()


HOSTILE = _trainer()
