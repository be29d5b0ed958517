"""Faults of the depth camera: lost, late, repeated or wrong frames, and new obstacles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sitl.camera.d435i import DEPTH_SPEC
from sitl.faults.injectors.base import Capabilities, DepthFrame, InjectionContext, Injector
from sitl.faults.injectors.obstacle import Obstacle, RendererWithObstacle
from sitl.faults.mavlink_proxy import DelayedItems
from sitl.geometry.quaternion import yaw_of

Change = Callable[[Any, np.random.Generator], Any]
HULL_M = 0.20
AHEAD_RAD = math.radians(25.0)  # from the heading: a box 1 m away is still in the image
APPEARED = "box appeared"  # key in notes: seconds from the onset
LIFTED_M = 0.15  # height of the body's centre above its place on the pad


class DepthSilence(Injector):
    """No depth frame for a while."""

    def __init__(self, for_s: float = 1e9) -> None:
        self._for_s = for_s

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Drop the frame until for_s."""
        return [] if since_s < self._for_s else [(0.0, frame)]


class AlteredDepth(Injector):
    """Wrong depth values for a while."""

    def __init__(self, change: Change, for_s: float = 1e9) -> None:
        self._change = change
        self._for_s = for_s
        self._rng = np.random.default_rng(5)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Change the depth values; time stamp and order stay correct."""
        if since_s >= self._for_s:
            return [(0.0, frame)]
        return [(0.0, dataclasses.replace(frame, depth_mm=self._change(frame.depth_mm, self._rng)))]


class SingleFrames(Injector):
    """Wrong depth values in one frame, again and again after every_s."""

    def __init__(self, change: Change, every_s: float) -> None:
        self._change = change
        self._every_s = every_s
        self._next_s = 0.0
        self._rng = np.random.default_rng(5)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Change the first frame of each period."""
        if since_s < self._next_s:
            return [(0.0, frame)]
        self._next_s = since_s + self._every_s
        return [(0.0, dataclasses.replace(frame, depth_mm=self._change(frame.depth_mm, self._rng)))]


class EveryNthFrame(Injector):
    """Wrong depth values in every n-th frame, beginning with the first."""

    def __init__(self, change: Change, n: int) -> None:
        self._change = change
        self._n = n
        self._count = 0
        self._rng = np.random.default_rng(5)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Change every n-th frame."""
        self._count += 1
        if (self._count - 1) % self._n:
            return [(0.0, frame)]
        return [(0.0, dataclasses.replace(frame, depth_mm=self._change(frame.depth_mm, self._rng)))]


class ScatteredFrames(Injector):
    """Wrong depth values in a random share of the frames."""

    def __init__(self, change: Change, share: float, seed: int) -> None:
        self._change = change
        self._share = share
        self._rng = np.random.default_rng(seed)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Change this share of the frames."""
        if self._rng.random() >= self._share:
            return [(0.0, frame)]
        return [(0.0, dataclasses.replace(frame, depth_mm=self._change(frame.depth_mm, self._rng)))]


class EmptyAfterLiftOff(Injector):
    """No returns in the first frames in the air."""

    def __init__(self, for_s: float) -> None:
        self._for_s = for_s
        self._lifted_s = math.inf

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Record the time of the lift-off."""
        if at.world.flyer.truth().position[2] > LIFTED_M:
            self._lifted_s = min(self._lifted_s, since_s)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Empty the frames of the first for_s seconds in the air."""
        if not self._lifted_s <= since_s < self._lifted_s + self._for_s:
            return [(0.0, frame)]
        return [(0.0, dataclasses.replace(frame, depth_mm=np.zeros_like(frame.depth_mm)))]


class LateFrames(Injector):
    """Frames that arrive late, with correct time stamps."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Delay every frame."""
        return [(self._delay_s, frame)]


class ReorderedFrames(Injector):
    """Every frame twice, and every third one after its successor."""

    def __init__(self) -> None:
        self._count = 0

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Return the frame again 0.05 s later; delay the first copy of every third one."""
        self._count += 1
        return [(0.35 if self._count % 3 == 0 else 0.0, frame), (0.05, frame)]


class ShiftedTimestamps(Injector):
    """Time stamps of another clock for a while; images and arrival times are correct."""

    def __init__(self, off_s: float, for_s: float = 1e9) -> None:
        self._off_s = off_s
        self._for_s = for_s

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Shift the time stamp by off_s."""
        off_s = self._off_s if since_s < self._for_s else 0.0
        return [(0.0, dataclasses.replace(frame, stamp_s=frame.stamp_s + off_s))]


class FrozenImage(Injector):
    """One image repeated under new time stamps, as a hung sensor sends it."""

    def __init__(self) -> None:
        self._kept: DepthFrame | None = None

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Return the first image of the fault with this frame's time stamp."""
        self._kept = self._kept or frame
        return [(0.0, dataclasses.replace(self._kept, stamp_s=frame.stamp_s))]


def constant(value: int) -> Change:
    """Return a change that sets every pixel to a value in millimetres; 0 is no return."""
    return lambda depth, _: np.full_like(depth, value)


def salted(share: float) -> Change:
    """Return a change that sets this share of the pixels to random values."""
    return lambda depth, rng: np.where(rng.random(depth.shape) < share, rng.integers(300, 6000, depth.shape), depth).astype(
        np.uint16
    )


def thinned(share: float) -> Change:
    """Return a change that leaves returns in this share of the pixels."""
    return lambda depth, rng: np.where(rng.random(depth.shape) < share, depth, 0).astype(np.uint16)


def ghost(centred: bool, near_mm: int = 1100, far_mm: int = 1500) -> Change:
    """Return a change that adds a near patch, as stereo matching of a repeated pattern does.

    It has a quarter of the image's width and height, one range in each frame, and hides what is behind it. centred: it lies in
    the middle of the image, else anywhere.
    """

    def change(depth: Any, rng: np.random.Generator) -> Any:
        rows, columns = depth.shape
        high, wide = rows // 4, columns // 4
        top, left = ((rows - high) // 2, (columns - wide) // 2)
        if not centred:
            top, left = int(rng.integers(0, rows - high)), int(rng.integers(0, columns - wide))
        out, range_mm = depth.copy(), int(rng.integers(near_mm, far_mm))
        patch = out[top : top + high, left : left + wide]
        patch[(patch == 0) | (patch > range_mm)] = range_mm
        return out

    return change


def false_wall(side_m: float, range_m: float) -> Change:
    """Return a change that adds a square wall across the optical axis.

    It hides what is behind it.
    """

    def change(depth: Any, _: np.random.Generator) -> Any:
        rows, columns = depth.shape
        high = round(0.5 * side_m / range_m * DEPTH_SPEC.fy * rows / DEPTH_SPEC.height)
        wide = round(0.5 * side_m / range_m * DEPTH_SPEC.fx * columns / DEPTH_SPEC.width)
        out, range_mm = depth.copy(), round(1000.0 * range_m)
        top, left = max(rows // 2 - high, 0), max(columns // 2 - wide, 0)
        patch = out[top : rows // 2 + high, left : columns // 2 + wide]
        patch[(patch == 0) | (patch > range_mm)] = range_mm
        return out

    return change


def shifted(pixels: int) -> Change:
    """Return a change that rolls the image sideways by some pixels."""
    return lambda depth, _: np.roll(depth, pixels, axis=1)


def bit_errors() -> Change:
    """Return a change that flips one bit in each of a third of the pixels."""
    return lambda depth, rng: np.where(
        rng.random(depth.shape) < 0.33, depth ^ (1 << rng.integers(0, 13, depth.shape)), depth
    ).astype(np.uint16)


def scaled(factor: float) -> Change:
    """Return a change that scales the depth, as a wrong unit or calibration does."""
    return lambda depth, _: np.clip(depth * factor, 0, 65535).astype(np.uint16)


class ObstacleAppears(Injector):
    """A box of a person's size that appears before the hull and stays.

    It stands ahead_m from the hull in the direction of travel.
    """

    def __init__(self, ahead_m: float, half_m: tuple[float, float, float] = (0.25, 0.35, 1.0)) -> None:
        self._ahead_m = ahead_m
        self._half_m = half_m

    def begin(self, at: InjectionContext) -> None:
        """Add the box where the vehicle is heading now."""
        truth = at.world.flyer.truth()
        speed = math.hypot(*truth.velocity[:2]) or 1.0
        away = HULL_M + self._ahead_m + self._half_m[0]
        x, y = (truth.position[k] + truth.velocity[k] / speed * away for k in (0, 1))
        add_obstacle(at, Obstacle(at.now_s, self._half_m, lambda _: (x, y, self._half_m[2] - 0.1)))


class ObstacleAppearsLater(ObstacleAppears):
    """A box that appears at the first fast flight forwards after a while."""

    def __init__(self, ahead_m: float, after_s: float, speed_mps: float) -> None:
        super().__init__(ahead_m)
        self._after_s = after_s
        self._speed_mps = speed_mps

    def begin(self, at: InjectionContext) -> None:
        """Wait."""

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Add the box once it is time."""
        truth = at.world.flyer.truth()
        vx, vy = truth.velocity[:2]
        off_nose_rad = abs(math.remainder(math.atan2(vy, vx) - yaw_of(truth.quat_wxyz), math.tau))
        due = since_s >= self._after_s and math.hypot(vx, vy) >= self._speed_mps and off_nose_rad <= AHEAD_RAD
        if due and APPEARED not in at.notes:
            at.notes[APPEARED] = since_s
            super().begin(at)


class ObstacleApproaches(Injector):
    """A box that comes towards the hovering vehicle.

    The vehicle is commanded to hold. Then the box moves from ahead_m before the camera at speed_mps to the vehicle's position,
    and stops there.
    """

    needs = Capabilities.STAGES

    def __init__(self, speed_mps: float, ahead_m: float = 3.0, after_s: float = 1.5) -> None:
        self._speed_mps = speed_mps
        self._ahead_m = ahead_m
        self._after_s = after_s
        self._come = False

    def begin(self, at: InjectionContext) -> None:
        """Command a hold."""
        at.hold = True

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Start the box along the camera's axis, once the vehicle hovers."""
        if self._come or since_s < self._after_s:
            return
        self._come = True
        truth, start_s, half_m = at.world.flyer.truth(), at.now_s, (0.25, 0.25, 1.0)
        yaw, (px, py, _) = yaw_of(truth.quat_wxyz), truth.position

        def place(now_s: float) -> tuple[float, float, float]:
            away = max(self._ahead_m - self._speed_mps * max(now_s - start_s, 0.0), 0.0)
            return px + away * math.cos(yaw), py + away * math.sin(yaw), 0.9

        add_obstacle(at, Obstacle(start_s, half_m, place))


class StaticObstacle(Injector):
    """A box at a fixed position of the world."""

    def __init__(self, place: tuple[float, float, float], half_m: tuple[float, float, float]) -> None:
        self._place = place
        self._half_m = half_m

    def begin(self, at: InjectionContext) -> None:
        """Add the box."""
        add_obstacle(at, Obstacle(at.now_s, self._half_m, lambda _: self._place))


def add_obstacle(at: InjectionContext, obstacle: Obstacle) -> None:
    """Add the obstacle to the camera's view and to the obstacles that the checks measure."""
    camera = at.world.camera
    camera.renderer = RendererWithObstacle(camera.renderer, obstacle, lambda: at.now_s)
    at.obstacles.append(obstacle)
