"""What a way costs in time: flying, turning, braking (paper, section III-C, with turning added)."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.proposal import Proposal
from uav_recon.planning.space.ways import Ways
from uav_recon.types.frames import FloatArray

LEAVING_TURN_SHARE = 0.25  # of the time to turn from a view's heading into the direction of flight: the camera should lead
BRAKING_MPS2 = 0.8  # changing the present velocity costs time too


def time_costs(
    ways: Ways,
    proposals: list[Proposal],
    yaw_rad: float,
    velocity_world_mps: FloatArray,
    speed_mps: float,
    yaw_rate_radps: float,
) -> FloatArray:
    """Seconds (N+1, N+1) from node to node, asymmetric: the longer of flying and turning, and what leaving costs.

    Leaving a view against its heading costs a share of that turn; leaving the vehicle's place costs the change of velocity.
    """
    yaws = np.array([yaw_rad] + [proposal.task.viewpoint.yaw_rad for proposal in proposals], dtype=np.float64)
    velocity = np.ascontiguousarray(velocity_world_mps, dtype=np.float64)
    costs: FloatArray = seconds(ways.lengths_m, ways.departures, yaws, velocity, float(speed_mps), float(yaw_rate_radps))
    return costs


@kernel
def seconds(
    lengths_m: FloatArray,
    departures: FloatArray,
    yaws_rad: FloatArray,
    velocity_world_mps: FloatArray,
    speed_mps: float,
    yaw_rate_radps: float,
) -> FloatArray:
    """time_costs for headings (N+1,) of the nodes."""
    nodes = len(yaws_rad)
    costs = np.zeros((nodes, nodes))
    speed_now = math.sqrt((velocity_world_mps * velocity_world_mps).sum())
    for i in range(nodes):
        for j in range(nodes):
            x, y, z = departures[i, j, 0], departures[i, j, 1], departures[i, j, 2]
            turn = abs(_wrapped(yaws_rad[j] - yaws_rad[i]))
            leaving = abs(_wrapped(math.atan2(y, x) - yaws_rad[i])) if math.sqrt(x * x + y * y) > 0.1 else 0.0
            costs[i, j] = (
                max(lengths_m[i, j] / speed_mps, turn / yaw_rate_radps) + LEAVING_TURN_SHARE * leaving / yaw_rate_radps
            )
            if i == 0:
                along = x * velocity_world_mps[0] + y * velocity_world_mps[1] + z * velocity_world_mps[2]
                costs[i, j] += (speed_now - along) / BRAKING_MPS2
    return costs


@kernel
def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def warm_up() -> None:
    """Compile."""
    seconds(np.zeros((2, 2)), np.zeros((2, 2, 3)), np.zeros(2), np.zeros(3), 1.0, 1.0)
