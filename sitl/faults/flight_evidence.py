"""Evidence that the checks may use: the simulator's ground truth and the captured MAVLink.

What the product claims is not evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sitl.faults.fault_director import EXTERNAL_CONTROL_MODES, FaultDirector, TruthSample
from sitl.faults.injectors.base import TAKEN_OVER
from sitl.faults.wire_capture import WireCapture, decode, heartbeats_in, setpoints_in
from sitl.outside_world import BODY_ABOVE_FLOOR_M, PAD_HEIGHT_M
from sitl.truth.hull_clearance import HullClearance

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

LOW_M = PAD_HEIGHT_M - BODY_ABOVE_FLOOR_M  # height above the surface below; the same as over the pad
BLIND_S = 0.15  # no ODOMETRY for this long: the product has no pose
HANDOVER_S = 0.3  # the last setpoint is sent within this time after the pilot's switch (scenario E1)


@dataclass(frozen=True)
class GuardLimits:
    """Limits that the product was configured with.

    Fence corners (m), inset from the fence (m), speed (m/s), acceleration (m/s²) and yaw rate (rad/s).
    """

    fence_min_m: tuple[float, float, float]
    fence_max_m: tuple[float, float, float]
    inset_m: float
    speed_mps: float
    acceleration_mps2: float
    yaw_rate_radps: float


@dataclass(frozen=True)
class FlightEvidence:
    """Evidence of one flight; times are in seconds on the world's clock.

    onset_s: when the fault began; inf if it never began.
    stamp_s (K,), position_m and velocity_mps (K, 3), yaw_rad (K,), armed (K,), mode (K,) and charge (K,; state of charge, 0 to
    1): true state at each turn.
    hull_s (H,) and hull_m (H,): times and true clearance, where clearance is measured.
    boxes_m (K,): distance from the hull to the obstacles of the fault; inf without an obstacle and on the ground.
    standing_m (K,): height at which the body would stand on the surface straight below it, from the beginning of a landing; 0
    is the floor.
    arrived_s (A,): arrival times of setpoints at the autopilot, after the faults.
    heard: (time, custom mode, armed) of each heartbeat that reached the product.
    notes: values that the injectors measured, by name.
    firmware: version of a real firmware, "" for a simulated autopilot.
    stop_codes: codes of the product's reason for the end of the flight, for checks of that report.
    reported: (time, codes) of each STATUSTEXT.
    """

    onset_s: float
    end_s: float
    stamp_s: F64
    position_m: F64
    velocity_mps: F64
    yaw_rad: F64
    armed: Bools
    mode: tuple[str, ...]
    hull_s: F64
    hull_m: F64
    obstacle_distance_m: F64
    standing_m: F64
    charge: F64
    failsafes: tuple[str, ...]
    texts: tuple[str, ...]
    wire: WireCapture
    arrived_s: F64
    heard: tuple[tuple[float, int, bool], ...]
    limits: GuardLimits
    boot_s: float = 0.0
    notes: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    stop_codes: tuple[str, ...] = ()
    reported: tuple[tuple[float, tuple[str, ...]], ...] = ()

    @cached_property
    def speed_mps(self) -> F64:
        """True speed (K,)."""
        return np.asarray(np.linalg.norm(self.velocity_mps, axis=1))

    @cached_property
    def product_responsible(self) -> Bools:
        """Mask (K,) of the turns in which the product is responsible for the vehicle's position.

        From HANDOVER_S after a pilot has taken control it is not responsible, unless the vehicle follows its setpoints again:
        the product must not interfere then. That pilot's sticks are never moved in the simulation, so without a position the
        vehicle drifts for as long as it is observed.
        """
        return (self.stamp_s < self.notes.get(TAKEN_OVER, math.inf) + HANDOVER_S) | self.ours

    @cached_property
    def clearance_m(self) -> float:
        """Least true clearance to the scene, inf if none was measured."""
        counts = np.interp(self.hull_s, self.stamp_s, self.product_responsible & ~self.blind_touchdown) > 0.5
        return float(self.hull_m[counts].min(initial=math.inf))

    @cached_property
    def blind_touchdown(self) -> Bools:
        """Mask (K,) of the turns in which the vehicle comes down blindly on a surface below it.

        That is the case when the product sent no pose as the landing began, so that the landing position could not be chosen.
        Contact is then no fault, as on a pad.
        """
        begun = np.flatnonzero(self.landing & self.armed)
        if not len(begun):
            return np.zeros(len(self.stamp_s), dtype=np.bool_)
        at_s = self.stamp_s[begun[0]]
        fed = bool(((self.wire.odometry_s > at_s - BLIND_S) & (self.wire.odometry_s <= at_s)).any())
        low: Bools = self.position_m[:, 2] - self.standing_m < LOW_M
        down: Bools = low & (self.standing_m > 0.0) & (self.stamp_s >= at_s)
        return down & (not fed)

    @cached_property
    def min_obstacle_distance_m(self) -> float:
        """Least distance from the hull to an obstacle of the fault, inf without an obstacle."""
        return float(self.obstacle_distance_m[self.product_responsible].min(initial=math.inf))

    @cached_property
    def ours(self) -> Bools:
        """Mask (K,) of the turns in which the vehicle followed the product's setpoints."""
        return np.array([mode in EXTERNAL_CONTROL_MODES for mode in self.mode], dtype=np.bool_) & self.armed

    @cached_property
    def landing(self) -> Bools:
        """Mask (K,) of the turns in which the autopilot was in a landing mode."""
        return np.array(["LAND" in mode for mode in self.mode], dtype=np.bool_)

    def reported_s(self, codes: Collection[str]) -> list[float]:
        """Return the instants of the STATUSTEXTs with one of these codes."""
        return [stamp_s for stamp_s, found in self.reported if not set(found).isdisjoint(codes)]

    def since(self, mask: Bools, from_s: float) -> float:
        """Return the seconds from from_s to the first turn after it where mask (K,) holds.

        It returns inf if there is none.
        """
        found = np.flatnonzero(mask & (self.stamp_s >= from_s))
        return float(self.stamp_s[found[0]] - from_s) if len(found) else math.inf


def gather(
    director: FaultDirector,
    limits: GuardLimits,
    hull_s: F64,
    hull_m: F64,
    radius_m: float,
    stop_codes: tuple[str, ...],
    codes_in: Callable[[str], tuple[str, ...]],
) -> FlightEvidence:
    """Return the evidence of a finished flight.

    hull_m: clearance to the scene. Distances to the obstacles of the fault are added here.
    """
    world, ledger, proxy = director.context.world, director.truth_samples, director.proxy
    assert proxy is not None
    stamps = np.array([m.stamp_s for m in ledger])
    positions = np.array([m.position_m for m in ledger]).reshape(-1, 3)
    armed = np.array([m.armed for m in ledger], dtype=np.bool_)
    airborne, boxes_m = armed & (positions[:, 2] > 0.05), np.full(len(stamps), math.inf)
    for obstacle in director.context.obstacles:
        boxes_m[airborne] = np.minimum(boxes_m[airborne], obstacle.hull_m(stamps[airborne], positions[airborne], radius_m))
    wire = decode(proxy.sent)
    return FlightEvidence(
        onset_s=director.onset_s,
        end_s=director.end_s,
        stamp_s=stamps,
        position_m=positions,
        velocity_mps=np.array([m.velocity_mps for m in ledger]).reshape(-1, 3),
        yaw_rad=np.array([m.yaw_rad for m in ledger]),
        armed=armed,
        mode=tuple(m.mode for m in ledger),
        hull_s=hull_s,
        hull_m=hull_m,
        obstacle_distance_m=boxes_m,
        standing_m=_standing(world.clearance, ledger),
        charge=np.array([m.charge for m in ledger]),
        failsafes=tuple(world.flyer.failsafes),
        texts=tuple(world.flyer.texts),
        wire=wire,
        arrived_s=setpoints_in(proxy.arrived),
        heard=tuple(heartbeats_in(proxy.heard)),
        limits=limits,
        boot_s=world.flyer.boot_s,
        notes=dict(director.context.notes),
        firmware=world.flyer.version,
        stop_codes=stop_codes,
        reported=tuple((stamp_s, codes_in(text)) for stamp_s, text in wire.texts),
    )


def _standing(room: HullClearance, ledger: Sequence[TruthSample]) -> F64:
    """Return standing_m (K,); 0 before the landing begins."""
    begun = next((k for k, m in enumerate(ledger) if m.armed and "LAND" in m.mode), len(ledger))
    return np.array([0.0] * begun + [max(room.standing_m(m.position_m), 0.0) for m in ledger[begun:]])
