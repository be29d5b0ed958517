"""Ray sampling on the device, with the same random draws as keyframes.ray_sampling.

The state of splitmix64 is a counter, so a batch depends only on seed, step and process. It is the same on every device, and
a resumed run draws what the uninterrupted run would have drawn.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uav_recon.mapping.neural.keyframes import ray_sampling
from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, DEPTH_UNIT_M, NORMAL_UNIT
from uav_recon.mapping.neural.keyframes.ray_sampling import FREE, NEAR, Views
from uav_recon.mapping.neural.sdf_numba.network import TRUNCATION_M

NUMBERS = 4 + NEAR + FREE  # random numbers per ray: two for the view, one for the ray, its samples, the jitter
SHAPE_SHARE = ray_sampling.SURFACE_POINTS / ray_sampling.RAYS  # share of the rays that also train gradient and normal


class DeviceViews(NamedTuple):
    """keyframes.ray_sampling.Views on a device.

    records (M, 10) i16, first (V + 1,) i64, rotation (V, 3, 3), position (V, 3), inverse_depth_sigma (V,), gain (V, 3),
    stretch (V, 2).
    """

    records: Tensor
    first: Tensor
    rotation: Tensor
    position: Tensor
    inverse_depth_sigma: Tensor
    gain: Tensor
    stretch: Tensor

    @staticmethod
    def of(views: Views, count: int, device: torch.device) -> DeviceViews:
        """Return the first ``count`` views on a device."""
        records = views.records[: views.first[count]]
        whole = (views.rotation, views.position, views.inverse_depth_sigma, views.gain, views.stretch)
        parts = (records, views.first[: count + 1], *(part[:count] for part in whole))
        return DeviceViews(*(torch.tensor(part, device=device) for part in parts))


class TorchBatch(NamedTuple):
    """A training batch with a colour entry for every ray.

    As keyframes.ray_sampling.NumbaBatch, but rays without a colour are included with weight 0.
    """

    points: Tensor
    target_m: Tensor
    weight: Tensor
    at_least: Tensor
    surface: Tensor
    normal: Tensor
    eikonal_weight: Tensor
    normal_weight: Tensor
    coloured: Tensor
    rgb: Tensor
    at_least_rgb: Tensor
    colour_weight: Tensor


def uniform(state: Tensor, count: int) -> Tensor:
    """Return the next numbers (count,) in [0, 1) of a splitmix64 stream.

    state (): int64 with the bits of the uint64 state.
    """
    z = state + _signed(0x9E3779B97F4A7C15) * torch.arange(1, count + 1, device=state.device)
    z = (z ^ _shifted(z, 30)) * _signed(0xBF58476D1CE4E5B9)
    z = (z ^ _shifted(z, 27)) * _signed(0x94D049BB133111EB)
    z = z ^ _shifted(z, 31)
    return _shifted(z, 40).float() * (1.0 / 16777216.0)


def state_before(seed: int, draws: int, rays: int) -> int:
    """Return the state of the stream after ``draws`` batches of ``rays`` rays."""
    return _signed((seed + draws * rays * NUMBERS * 0x9E3779B97F4A7C15) % (1 << 64))


def draw(state: Tensor, views: DeviceViews, low: Tensor, high: Tensor, rays: int, recent_share: float) -> TorchBatch:
    """Return a batch of random rays.

    low, high (3,): the box. recent_share of the rays come from the last views.
    """
    number = uniform(state, rays * NUMBERS).view(rays, NUMBERS)
    view, record = _choose(number, views, recent_share)
    rotation, position = views.rotation[view], views.position[view]
    stretch = views.stretch[view]
    bearing = torch.cat([record[:, :2].float() * (stretch[:, :1] * BEARING_UNIT), torch.ones_like(number[:, :1])], dim=1)
    length = bearing.square().sum(dim=1).sqrt()
    z = (record[:, 2].long() & 0xFFFF).float() * (stretch[:, 1] * DEPTH_UNIT_M)
    reach, sigma = z * length, z * z * views.inverse_depth_sigma[view]
    direction = (rotation @ bearing[:, :, None])[:, :, 0] / length[:, None]
    seen_normal = record[:, 3:6].float() * NORMAL_UNIT
    normal = (rotation @ seen_normal[:, :, None])[:, :, 0]
    has_normal = seen_normal.square().sum(dim=1) > 0.5
    cosine = torch.where(has_normal, (direction * normal).sum(dim=1).abs().clamp(min=float(ray_sampling.MIN_COSINE)), 0.7)
    variance = float(ray_sampling.POSE_SIGMA_M) ** 2
    trust = (variance / (variance + sigma.square())).clamp(min=float(ray_sampling.MIN_TRUST))

    before, behind = float(ray_sampling.NEAR_BEFORE_M), float(ray_sampling.NEAR_BEHIND_M)
    truncation_m, nearest_m = float(TRUNCATION_M), float(ray_sampling.NEAREST_FREE_M)
    steps = torch.arange(NEAR + FREE, device=state.device)
    near_t = reach[:, None] - before + (steps[:NEAR] + number[:, 3 : 3 + NEAR]) / NEAR * (before + behind)
    free_share = (steps[:FREE] + number[:, 3 + NEAR : 3 + NEAR + FREE]) / FREE
    free_t = nearest_m + free_share * (reach[:, None] - before - nearest_m)
    t = torch.cat([near_t, free_t], dim=1)
    near_target = (reach[:, None] - near_t) * cosine[:, None]
    free_target = ((reach - 2.0 * sigma)[:, None] - free_t) * cosine[:, None]
    target = torch.cat([near_target, free_target.clamp(0.0, truncation_m)], dim=1)
    near_weight = trust * (float(ray_sampling.DISTANCE_FACTOR) / (truncation_m**2 * rays * NEAR))
    free_weight = float(ray_sampling.FREE_FACTOR) / (truncation_m**2 * rays * FREE)
    weight = torch.where(steps < NEAR, near_weight[:, None], free_weight)
    points = position[:, None] + t[:, :, None] * direction[:, None]
    usable = _inside(points, low, high) & (t >= 0.5 * nearest_m)

    jitter = (1.0 - 2.0 * number[:, -1]) * float(ray_sampling.JITTER_M)
    end = position + (reach + jitter)[:, None] * direction
    inside = _inside(end, low, high)
    shape, toe = int(rays * SHAPE_SHARE), float(ray_sampling.TOE)
    return TorchBatch(
        points.view(-1, 3),
        target.flatten(),
        (weight * usable).flatten(),
        (steps >= NEAR).expand(rays, -1).flatten(),
        end[:shape],
        normal[:shape],
        inside[:shape] * (float(ray_sampling.EIKONAL_FACTOR) / shape),
        (inside & has_normal)[:shape] * trust[:shape] * (float(ray_sampling.NORMAL_FACTOR) / shape),
        end,
        (record[:, 6:9].float() * (1.0 / 255.0) + toe) * views.gain[view] - toe,
        record[:, 6:9] >= ray_sampling.WHITE,
        (inside & (record[:, 9] == 1)) * (float(ray_sampling.COLOUR_FACTOR) / rays),
    )


def _choose(number: Tensor, views: DeviceViews, recent_share: float) -> tuple[Tensor, Tensor]:
    count = len(views.rotation)
    pick = number[:, 1].double()
    late = count - 1 - (pick * min(ray_sampling.RECENT_VIEWS, count)).long()
    view = torch.where(number[:, 0] < recent_share, late, (pick * count).long())
    first = views.first[view]
    within = (number[:, 2].double() * (views.first[view + 1] - first)).long()
    return view, views.records[first + within]


def _inside(points: Tensor, low: Tensor, high: Tensor) -> Tensor:
    return ((points > low) & (points < high)).all(dim=-1)


def _signed(value: int) -> int:
    return int(np.uint64(value).astype(np.int64))


def _shifted(z: Tensor, bits: int) -> Tensor:
    """Shift to the right, filling with zeros as for unsigned numbers."""
    return (z >> bits) & ((1 << (64 - bits)) - 1)
