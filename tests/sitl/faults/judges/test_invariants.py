"""What holds in every flight: a sound flight passes, and each violation is seen and named."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from made_up_evidence import DT_S, rewired, spoilt
from made_up_evidence import evidence as flown

from sitl.faults import reason_codes as codes
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.base import TAKEN_OVER
from sitl.faults.judges.invariants import Room, violations
from sitl.faults.table.all_scenarios import TABLE
from sitl.faults.wire_capture import CapturedCommand

Spoil = Callable[[FlightEvidence], FlightEvidence]
LIMIT_RADPS = 1.0  # of the flight's limits
ASKED = (codes.MISSION_LAND,)


def evidence(**changes: Any) -> FlightEvidence:
    """The flight that never was, which says why it lands and turns all the way, past the back."""
    plain = flown(**{"reported": ((6.0, ("refused",)), (15.1, ASKED)), **changes})
    turns = np.remainder(0.7 * plain.wire.setpoint_s, 2.0 * np.pi)
    return rewired(plain, yaw_rad=turns)


def hovering(e: FlightEvidence, mode: str = "OFFBOARD", **changes: Any) -> FlightEvidence:
    """Armed and alone until the end, and the end is far."""
    t = np.arange(0.0, 90.0, 1.0 / 30.0)
    place = np.tile([1.0, 0.0, 1.0], (len(t), 1))
    return dataclasses.replace(
        e, stamp_s=t, position_m=place, velocity_mps=np.zeros_like(place), yaw_rad=np.zeros(len(t)),
        armed=np.ones(len(t), bool), mode=(mode,) * len(t), obstacle_distance_m=np.full(len(t), np.inf),
        standing_m=np.zeros(len(t)),
        end_s=90.0, **changes,
    )  # fmt: skip


def taken(e: FlightEvidence, said: tuple[float, str] | None, mode: str = "POSCTL") -> FlightEvidence:
    """Another's mode is set at 9.9 s, the product hears of it at 10 s and sends no setpoint any more. said: its STATUSTEXT."""
    theirs = dataclasses.replace(
        e, mode=tuple(mode if t > 9.9 else "OFFBOARD" for t in e.stamp_s),
        heard=tuple((t, 3 << 16 if t >= 10.0 else 6 << 16, True) for t in range(20)),
        reported=() if said is None else ((said[0], (said[1],)),),
    )  # fmt: skip
    sent = e.wire.setpoint_s < 10.0
    streams = {
        name: getattr(e.wire, name)[sent]
        for name in (
            "setpoint_s", "setpoint_stamp_ms", "position_m", "velocity_mps", "acceleration_mps2", "yaw_rate_radps", "yaw_rad",
        )
    }  # fmt: skip
    return rewired(theirs, orders=e.wire.orders[:2], **streams)


SPOILS: dict[str, Spoil] = {
    "contact": lambda e: dataclasses.replace(e, hull_m=spoilt(e.hull_m, 200, 0.0)),
    "contact: clearance": lambda e: dataclasses.replace(e, obstacle_distance_m=np.zeros(len(e.stamp_s))),
    "clearance 0.090 m": lambda e: dataclasses.replace(e, hull_m=spoilt(e.hull_m, 200, 0.09)),
    "clearance 0.080 m": lambda e: dataclasses.replace(e, obstacle_distance_m=np.full(len(e.stamp_s), 0.08)),
    "fence overshot": lambda e: dataclasses.replace(e, position_m=spoilt(e.position_m, (200, 1), 3.4)),
    "NaN": lambda e: rewired(e, not_finite=1),
    "m/s²": lambda e: rewired(e, acceleration_mps2=spoilt(e.wire.acceleration_mps2, (100, 0), 2.1)),
    "m/s": lambda e: rewired(e, velocity_mps=spoilt(e.wire.velocity_mps, slice(100, 110), (1.25, 0.0, 0.0))),
    "rad/s": lambda e: rewired(e, yaw_rate_radps=spoilt(e.wire.yaw_rate_radps, 100, -1.1)),
    "jumps 0": lambda e: rewired(e, position_m=e.wire.position_m + np.where(e.wire.setpoint_s > 7.0, 0.2, 0.0)[:, None]),
    "heading jumps": lambda e: rewired(e, yaw_rad=e.wire.yaw_rad + np.where(e.wire.setpoint_s > 7.0, 0.2, 0.0)),
    "velocity jumps": lambda e: rewired(e, velocity_mps=spoilt(e.wire.velocity_mps, (100, 1), 0.5)),
    "out of the inset fence": lambda e: rewired(e, position_m=spoilt(e.wire.position_m, (slice(None), 1), 2.8)),
    "after the pilot took over": lambda e: rewired(
        dataclasses.replace(e, mode=tuple("POSCTL" if t > 8.0 else m for t, m in zip(e.stamp_s, e.mode, strict=True))),
        orders=(*e.wire.orders, CapturedCommand(9.0, 176, 1.0, 6.0)),
    ),
    "disarm command in the air": lambda e: rewired(e, orders=(*e.wire.orders, CapturedCommand(9.0, 400, 0.0, 21196.0))),
    "disarmed in the air": lambda e: dataclasses.replace(e, armed=e.stamp_s < 9.0),
    "hovers": hovering,
    "hovers armed": lambda e: hovering(e, "LOITER"),
    "landing requested 10.0 s after the fault and not reported": lambda e: dataclasses.replace(e, reported=e.reported[:1]),
    "landing requested 10.0 s after": lambda e: dataclasses.replace(
        e, reported=(*e.reported[:1], (15.1, ("refused", "position-step")))
    ),
    "foreign mode 5.0 s after the fault and not reported": lambda e: taken(e, (12.0, codes.CONTROL_RELEASED)),
    "foreign mode 5.0 s after the fault and not": lambda e: taken(e, (10.2, "speed-limit"), "LAND"),
    "foreign mode 5.0 s": lambda e: taken(e, (9.9, codes.NO_POSE)),
    "foreign mode 5.0 s after": lambda e: taken(e, (10.9, codes.OPERATOR_SILENT)),
}


def test_a_sound_flight_breaks_nothing() -> None:
    assert violations(evidence()) == []


@pytest.mark.parametrize("said", SPOILS)
def test_each_violation_is_seen_and_named(said: str) -> None:
    assert any(said in words for words in violations(SPOILS[said](evidence())))


def test_what_is_allowed_is_no_violation() -> None:
    reset = evidence()
    counter = np.where(reset.wire.odometry_s > 7.0, 1.0, 0.0)
    shifted = reset.wire.position_m + counter[:, None] * (0.5, 0.0, 0.0)
    assert violations(rewired(reset, reset_counter=counter, position_m=shifted)) == [], "setpoints move with a reset pose"
    over = tuple("POSCTL" if t > 14.0 else m for t, m in zip(reset.stamp_s, reset.mode, strict=True))
    quiet = dataclasses.replace(reset, mode=over)
    assert violations(rewired(quiet, orders=reset.wire.orders[:2])) == [], "a pilot may take over"


def on_a_table(fed_until_s: float, touched_s: float = 16.8) -> FlightEvidence:
    """Comes down on something 0.3 m high and stands there at 17.1 s, its hull near it from such an instant on."""
    e = evidence()
    over, fed = e.stamp_s > 15.0, e.wire.odometry_s < fed_until_s
    place = np.where(over[:, None], np.maximum(e.position_m, (-9.0, -9.0, 0.3)), e.position_m)
    down = dataclasses.replace(
        e, position_m=place, standing_m=np.where(over, 0.3, 0.0), hull_s=e.stamp_s,
        hull_m=np.where(e.stamp_s > touched_s, 0.0, 0.5),
    )  # fmt: skip
    return rewired(down, odometry_s=e.wire.odometry_s[fed], reset_counter=e.wire.reset_counter[fed])


def test_without_a_pose_it_may_come_down_on_what_stands_below_it() -> None:
    assert violations(on_a_table(14.5)) == []
    assert any("contact" in said for said in violations(on_a_table(15.0))), "with one it could have chosen a place"
    assert any("contact" in said for said in violations(on_a_table(14.5, 15.5))), "still high over it"
    nothing_there = dataclasses.replace(on_a_table(14.5), standing_m=np.zeros(len(evidence().stamp_s)))
    assert any("disarmed in the air" in said for said in violations(nothing_there))


def test_a_pilot_who_took_the_vehicle_may_hover_with_it() -> None:
    silent = rewired(evidence(), orders=())
    assert violations(hovering(silent, "LOITER", notes={TAKEN_OVER: 6.0})) == []
    for mode in ("OFFBOARD", "LAND"):
        gone = hovering(silent, mode, notes={TAKEN_OVER: 6.0})
        assert violations(gone) == ["hovers armed and unattended"], "it is the pilot's no more"


@pytest.mark.parametrize("code", codes.LANDING)
def test_each_reason_for_a_landing_is_one_also_as_a_detail(code: str) -> None:
    for reason in ((code,), ("few-words", code)):
        assert violations(evidence(reported=((15.1, reason),))) == []


OTHER = (
    ("refused", "speed-limit"), ("refused", "trajectory-not-finite"), ("pose-source-reset",), (), ("intruder-mavlink1",),
    ("link-slow",), ("operator-back",), ("operator-lost-returning",),
)  # fmt: skip


@pytest.mark.parametrize("other", OTHER)
def test_what_is_said_of_another_thing_is_no_reason_for_a_landing(other: tuple[str, ...]) -> None:
    assert violations(evidence(reported=((15.1, other),))) != []


def test_a_pilot_who_takes_the_vehicle_out_of_our_landing_keeps_it() -> None:
    e = evidence()
    kept = dataclasses.replace(e, mode=tuple("POSCTL" if t > 16.0 else m for t, m in zip(e.stamp_s, e.mode, strict=True)))
    again = rewired(kept, orders=(*e.wire.orders, CapturedCommand(17.0, 176, 1.0, 4.0)))
    assert violations(kept) == [], "the order to land came before"
    assert violations(again) == ["1 mode or arm commands after the pilot took over"]
    known_s = next(s for s, _, _ in e.heard if s > 16.0)
    en_route = rewired(kept, orders=(*e.wire.orders, CapturedCommand(known_s + 0.01, 176, 1.0, 4.0)))
    assert violations(en_route) == [], "sent before it could have heard"


def test_what_was_told_in_time_or_could_not_be_known_is_no_violation() -> None:
    assert violations(taken(evidence(), (10.9, codes.CONTROL_RELEASED))) == []
    assert violations(taken(evidence(), (9.9, codes.NO_POSE), "LAND")) == [], "it was about to land, and said why"
    deaf = taken(evidence(), None)
    assert violations(dataclasses.replace(deaf, heard=deaf.heard[:10])) == [], "it never heard of it"
    dead = rewired(deaf, setpoint_s=deaf.wire.setpoint_s - 0.6)
    assert violations(dead) == [], "it had no part in it"
    landing = tuple("LAND" if t > 15.2 else "OFFBOARD" for t in evidence().stamp_s)
    assert violations(evidence(mode=landing)) == [], "the mode that it asked for"


def test_setpoints_that_arrive_together_were_sent_apart() -> None:
    flown = evidence()
    brake = spoilt(
        flown.wire.velocity_mps, slice(150, 152), ((0.5, 0.0, 0.0), (0.39, 0.0, 0.0))
    )  # 0.11 m/s in a turn of the loop
    brake[152:, 0] = np.minimum(brake[152:, 0], 0.39)
    late = spoilt(flown.wire.setpoint_s, 150, float(flown.wire.setpoint_s[151]) - 0.001)
    held_up = rewired(flown, setpoint_s=late, velocity_mps=brake)
    assert violations(held_up) == []
    together = spoilt(flown.wire.setpoint_stamp_ms, 150, float(flown.wire.setpoint_stamp_ms[151]) - 1.0)
    assert any("velocity jumps" in words for words in violations(rewired(held_up, setpoint_stamp_ms=together)))


def ramped(speed_mps: float, acceleration_mps2: float) -> FlightEvidence:
    """From 7 s on setpoints go faster and faster aside for 1 s, and then on so fast."""
    e = evidence()
    since_s = np.clip(e.wire.setpoint_s - 7.0, 0.0, 1.0)
    gone_m = np.cumsum(np.where((e.wire.setpoint_s > 7.0) & (e.wire.setpoint_s < 7.5), speed_mps, 0.0)) * DT_S
    aside, push = np.array([0.0, 1.0, 0.0]), np.minimum(since_s * acceleration_mps2, 1.0)
    return rewired(
        e, position_m=e.wire.position_m * [0.0, 0.0, 1.0] + gone_m[:, None] * aside,
        velocity_mps=e.wire.velocity_mps * [0.0, 0.0, 1.0] + push[:, None] * aside,
    )  # fmt: skip


def turning(rate_radps: float) -> FlightEvidence:
    """From 7 s on setpoints turn at this rate for a second."""
    e = evidence()
    return rewired(e, yaw_rad=rate_radps * np.clip(e.wire.setpoint_s - 7.0, 0.0, 1.0))


def test_the_heading_may_turn_as_fast_as_the_limit_says() -> None:
    assert evidence().limits.yaw_rate_radps == LIMIT_RADPS
    assert violations(turning(LIMIT_RADPS)) == violations(turning(-LIMIT_RADPS)) == []
    assert any("heading jumps" in words for words in violations(turning(1.5 * LIMIT_RADPS))), "over a while, in no frame"
    frame = rewired(evidence(), yaw_rad=spoilt(np.zeros(len(evidence().wire.setpoint_s)), slice(150, None), 0.1))
    assert any("heading jumps by 3 degrees too much within 0.03 s" in words for words in violations(frame))


def test_a_heading_that_a_reset_turns_jumps_not_and_one_that_is_not_asked_for_cannot() -> None:
    e = evidence()
    later = e.wire.odometry_s > 7.0
    turned = e.wire.yaw_rad + np.where(later, 0.5, 0.0)
    assert violations(rewired(e, yaw_rad=turned)) != []
    assert violations(rewired(e, yaw_rad=turned, reset_counter=np.where(later, 1.0, 0.0))) == []
    assert violations(rewired(e, yaw_rad=np.full(len(turned), np.nan))) == []


def test_what_each_frame_may_be_off_does_not_add_up_over_a_while() -> None:
    assert violations(ramped(1.2, 2.0)) == []
    assert any("setpoint jumps" in words for words in violations(ramped(2.2, 0.0)))
    assert any("velocity jumps" in words for words in violations(ramped(0.0, 4.2)))


def test_a_pilot_that_restarts_may_begin_elsewhere_also_over_a_while() -> None:
    e = evidence()
    again = np.where(e.wire.setpoint_s > 8.0, 0.9, 0.0)
    keep = (e.wire.setpoint_s < 7.4) | (e.wire.setpoint_s > 8.0)
    parts = {
        name: getattr(e.wire, name)[keep]
        for name in ("setpoint_s", "setpoint_stamp_ms", "velocity_mps", "yaw_rate_radps", "yaw_rad")
    }
    moved = (e.wire.position_m + again[:, None] * (0.0, 1.0, 0.0))[keep]
    assert violations(rewired(e, **parts, position_m=moved, acceleration_mps2=e.wire.acceleration_mps2[keep])) == []


@pytest.mark.parametrize("leap_ms", [200.0, 5000.0])
def test_stamps_that_leap_hide_no_jump(leap_ms: float) -> None:
    jumps = SPOILS["jumps 0"](evidence())
    stamps = jumps.wire.setpoint_stamp_ms + np.where(jumps.wire.setpoint_s > 7.0, leap_ms, 0.0)
    assert any("jumps 0" in words for words in violations(rewired(jumps, setpoint_stamp_ms=stamps)))


def test_a_row_may_allow_more_of_the_fence_and_is_held_to_that() -> None:
    e = evidence()
    out = dataclasses.replace(e, position_m=spoilt(e.position_m, (200, 1), 3.5))
    assert violations(out) == violations(out, Room(overshoot_m=0.30)) == ["fence overshot by 0.50 m"]
    assert violations(out, Room(overshoot_m=0.51)) == []
    assert all(scenario.room.overshoot_m == 0.30 for scenario in TABLE), "none but a pair of two faults"
