"""Base class of the fault injectors, and the context that they may act on."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from enum import Flag, auto
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.faults.injectors.obstacle import Obstacle
from sitl.faults.mavlink_proxy import DelayedItems, MavlinkProxy
from sitl.faults.process_registry import ProcessRegistry
from sitl.outside_world import OutsideWorld
from sitl.runtime.serial_line import SerialLine
from sitl.world.pose_tracker import PoseRecord

TAKEN_OVER = "taken over"  # key in notes: time of the pilot's switch
ATTENDED = "attended"  # key in notes: time of the operator's last status query


class Capabilities(Flag):
    """Requirements of a fault for its flight, or features that a flight offers."""

    NOTHING = 0
    STAGES = auto()  # lockstep: the product's stages run in this process
    PROCESSES = auto()  # real time: each stage runs in a separate process
    SIMULATOR_ACCESS = auto()  # access to the simulated autopilot and its physics
    RC_TRANSMITTER = auto()  # a pilot's transmitter
    SERIAL_LINE = auto()  # a serial line to the product


@dataclass
class InjectionContext:
    """Objects of the flight that an injector may act on.

    dice: seeded by the flight's seed.
    channels: the product's own channels, for hostile stages in lockstep.
    registry, config: the processes of a real-time flight, and the configuration file that they read.
    line: the serial line of the link, for a fault that needs one.
    notes: values that injectors measured.
    """

    world: OutsideWorld
    dice: random.Random
    channels: Any = None
    proxy: MavlinkProxy | None = None
    now_s: float = 0.0
    hold: bool = False
    abort: bool = False  # the operator has commanded a landing
    attends: bool = True  # the operator queries the status once a second
    obstacles: list[Obstacle] = field(default_factory=list)
    registry: ProcessRegistry | None = None
    line: SerialLine | None = None
    config: Path | None = None
    notes: dict[str, float] = field(default_factory=dict)


class Injector:
    """Fault without an effect; each kind of fault overrides the methods that it needs.

    since_s counts from the beginning of the fault; no method is called before it. Frames are whole MAVLink frames. An item that
    is returned with a delay does not overtake an earlier one.
    """

    needs: Capabilities = Capabilities.NOTHING

    def begin(self, at: InjectionContext) -> None:
        """Begin the fault."""

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Act once in each turn of the flight."""

    def end(self, at: InjectionContext) -> None:
        """Undo the fault at the end of the flight."""

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Return the result for a pose that the tracker delivers now."""
        return [(0.0, record)]

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Return the result for a depth frame."""
        return [(0.0, frame)]

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        """Return the result for an inertial sample."""
        return [(0.0, sample)]

    def to_autopilot(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Return the result for a MAVLink frame of the product."""
        return [(0.0, frame)]

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Return the result for a MAVLink frame of the autopilot."""
        return [(0.0, frame)]

    def stalls(self, since_s: float, stage: str) -> bool:
        """Return whether the loop of a stage does not run: mission, perception, pilot or planner."""
        return False

    def restarts(self, since_s: float, stage: str) -> bool:
        """Return whether a stage is rebuilt now. Called once per turn."""
        return False


@dataclass(frozen=True)
class DepthFrame:
    """Depth frame in transit: depth_mm (H, W) uint16, 0 = no return; rgb (h, w, 3) uint8."""

    stamp_s: float
    depth_mm: Any
    rgb: Any


@dataclass(frozen=True, slots=True)
class StreamedImuSample:
    """Inertial sample in transit: gyro (3,), rad/s; specific force (3,), m/s^2; body FLU."""

    stamp_s: float
    gyro_radps: NDArray[np.float64]
    specific_force_mps2: NDArray[np.float64]
