"""Travel time of a path: flying, turning, braking.

Paper, section III-C, with turning added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.types.frames import FloatArray

# share of the time to turn from a view's heading to the flight direction, because the camera should look ahead
LEAVING_TURN_SHARE = 0.25
BRAKING_MPS2 = 0.8  # changing the present velocity takes time too
LEVEL = 0.1  # a direction with a smaller horizontal part is vertical and has no heading


class TravelTimeModel(Protocol):
    """Predicts the travel time of paths, matching the yaw policy of motion planning."""

    def seconds(
        self, lengths_m: FloatArray, departures: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> FloatArray:
        """Return the seconds (N, N) from node to node, at rest in both.

        lengths_m: (N, N) path lengths.
        departures: (N, N, 3) unit directions in which the path from i to j leaves i.
        yaw_rad, pitch_down_rad: (N,) viewing direction of the camera at each node.
        """
        ...


@dataclass(frozen=True, slots=True)
class YawWhileFlying:
    """The longer of flight time and turning time.

    A share of the turn from a view's heading to the flight direction is added.
    """

    speed_mps: float
    rate_radps: float

    def seconds(
        self, lengths_m: FloatArray, departures: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> FloatArray:
        """See TravelTimeModel."""
        costs: FloatArray = yaw_while_flying(lengths_m, departures, yaw_rad, self.speed_mps, self.rate_radps)
        return costs


@dataclass(frozen=True, slots=True)
class YawThenFly:
    """Turn until the camera sees the path, fly, turn to the view; or fly slowly while turning.

    The faster of the two is used.

    blind_speed_mps: speed outside the camera's view.
    max_offset_rad: max. angle between heading and path.
    vertical_tangent: tangent of the used part of half the vertical angle of view.
    """

    speed_mps: float
    rate_radps: float
    blind_speed_mps: float
    max_offset_rad: float
    vertical_tangent: float

    def seconds(
        self, lengths_m: FloatArray, departures: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> FloatArray:
        """See TravelTimeModel."""
        costs: FloatArray = yaw_then_fly(
            lengths_m, departures, yaw_rad, pitch_down_rad, self.speed_mps, self.rate_radps, self.blind_speed_mps,
            self.max_offset_rad, self.vertical_tangent,
        )  # fmt: skip
        return costs


def time_costs(
    path_cache: PathCache,
    proposals: list[CandidateView],
    yaw_rad: float,
    velocity_world_mps: FloatArray,
    travel_time_model: TravelTimeModel,
) -> FloatArray:
    """Return the seconds (N+1, N+1) from node to node, asymmetric.

    Leaving the vehicle's position also costs the change of velocity.
    """
    views = [proposal.task.viewpoint for proposal in proposals]
    yaws = np.array([yaw_rad, *(view.yaw_rad for view in views)], dtype=np.float64)
    pitches = np.array([0.0, *(view.pitch_down_rad for view in views)], dtype=np.float64)  # no view is taken at node 0
    costs = travel_time_model.seconds(path_cache.lengths_m, path_cache.departures, yaws, pitches)
    leave(costs, path_cache.departures, np.ascontiguousarray(velocity_world_mps, dtype=np.float64))
    return costs


@kernel
def leave(costs: FloatArray, departures: FloatArray, velocity_world_mps: FloatArray) -> None:
    """Add the time to change the velocity (3,) to the costs (N, N) from node 0."""
    speed_now = math.sqrt((velocity_world_mps * velocity_world_mps).sum())
    for j in range(len(costs)):
        x, y, z = departures[0, j, 0], departures[0, j, 1], departures[0, j, 2]
        along = x * velocity_world_mps[0] + y * velocity_world_mps[1] + z * velocity_world_mps[2]
        costs[0, j] += (speed_now - along) / BRAKING_MPS2


@kernel
def yaw_while_flying(
    lengths_m: FloatArray, departures: FloatArray, yaw_rad: FloatArray, speed_mps: float, rate_radps: float
) -> FloatArray:
    """Compute YawWhileFlying.seconds."""
    nodes = len(yaw_rad)
    costs = np.zeros((nodes, nodes))
    for i in range(nodes):
        for j in range(nodes):
            x, y = departures[i, j, 0], departures[i, j, 1]
            turn = abs(_wrapped(yaw_rad[j] - yaw_rad[i]))
            leaving = abs(_wrapped(math.atan2(y, x) - yaw_rad[i])) if math.sqrt(x * x + y * y) > LEVEL else 0.0
            costs[i, j] = max(lengths_m[i, j] / speed_mps, turn / rate_radps) + LEAVING_TURN_SHARE * leaving / rate_radps
    return costs


@kernel
def yaw_then_fly(
    lengths_m: FloatArray, departures: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, speed_mps: float,
    rate_radps: float, blind_speed_mps: float, max_offset_rad: float, vertical_tangent: float,
) -> FloatArray:  # fmt: skip
    """Compute YawThenFly.seconds.

    Of a path with bends, only the first and last directions count.
    """
    nodes = len(yaw_rad)
    costs = np.zeros((nodes, nodes))
    for i in range(nodes):
        for j in range(nodes):
            if i == j:
                continue
            slowly = max(lengths_m[i, j] / blind_speed_mps, abs(_wrapped(yaw_rad[j] - yaw_rad[i])) / rate_radps)
            costs[i, j] = slowly
            first, last = departures[i, j], departures[j, i]  # the last direction points back
            if not (
                _seen(first, 1.0, pitch_down_rad[j], vertical_tangent)
                and _seen(last, -1.0, pitch_down_rad[j], vertical_tangent)
            ):
                continue
            there = _turned(yaw_rad[i], math.atan2(first[1], first[0]), max_offset_rad)
            arrived = _turned(there, math.atan2(-last[1], -last[0]), max_offset_rad)
            turn = abs(there - yaw_rad[i]) + abs(arrived - there) + abs(_wrapped(yaw_rad[j] - arrived))
            costs[i, j] = min(slowly, turn / rate_radps + lengths_m[i, j] / speed_mps)
    return costs


@kernel
def _seen(direction: FloatArray, sign: float, pitch_down_rad: float, vertical_tangent: float) -> bool:
    """Return True if the camera sees along a path direction (3,).

    The direction must have a heading and must not be too steep.

    sign: 1.0 for the direction itself, -1.0 for its reverse.
    """
    ahead, up = math.sqrt(direction[0] ** 2 + direction[1] ** 2), sign * direction[2]
    depth = math.cos(pitch_down_rad) * ahead - math.sin(pitch_down_rad) * up
    below = -math.sin(pitch_down_rad) * ahead - math.cos(pitch_down_rad) * up
    return bool(ahead > LEVEL and abs(below) <= vertical_tangent * depth)


@kernel
def _turned(yaw_rad: float, bearing_rad: float, max_offset_rad: float) -> float:
    """Return the heading after turning towards a bearing until it is within max_offset_rad."""
    off = _wrapped(bearing_rad - yaw_rad)
    return float(yaw_rad + math.copysign(max(abs(off) - max_offset_rad, 0.0), off))


@kernel
def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def warm_up() -> None:
    """Compile all kernels."""
    none = np.zeros((2, 2)), np.zeros((2, 2, 3)), np.zeros(2), np.zeros(2)
    leave(none[0], none[1], np.zeros(3))
    YawWhileFlying(1.0, 1.0).seconds(*none)
    YawThenFly(1.0, 1.0, 0.3, 0.6, 0.5).seconds(*none)
