"""What can be made to go wrong: one small object a trouble, and what it may lay hands on."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from enum import Flag, auto
from pathlib import Path
from typing import Any

from sitl.faults.injectors.obstacle import Obstacle
from sitl.faults.mavlink_proxy import Late, Tap
from sitl.faults.process_registry import ProcessRegistry
from sitl.outside_world import OutsideWorld
from sitl.runtime.serial_line import SerialLine
from sitl.world.pose_tracker import PoseRecord

TAKEN_OVER = "taken over"  # note: the instant of the pilot's switch
ATTENDED = "attended"  # note: the instant of the operator's last sign of life


class Capabilities(Flag):
    """What a trouble wants of the flight that it is in, or a flight has to give."""

    NOTHING = 0
    STAGES = auto()  # the product's stages in this process: lockstep
    PROCESSES = auto()  # or each in its own: real time
    INSIDES = auto()  # of the simulated autopilot and its physics
    STICKS = auto()  # a pilot's transmitter
    LINE = auto()  # a serial line to the product


@dataclass
class InjectionContext:
    """What an injector may lay hands on. dice: of the flight's seed. channels: the product's own, for hostile stages in
    lockstep. roster, config: the processes of a flight in real time, and the file that they read. line: what the link is, where
    a trouble needs it. notes: what an injector measured itself.
    """

    world: OutsideWorld
    dice: random.Random
    channels: Any = None
    proxy: Tap | None = None
    now_s: float = 0.0
    hold: bool = False
    abort: bool = False  # the operator has pressed
    attends: bool = True  # the operator asks how it stands, once a second
    obstacles: list[Obstacle] = field(default_factory=list)
    roster: ProcessRegistry | None = None
    line: SerialLine | None = None
    config: Path | None = None
    notes: dict[str, float] = field(default_factory=dict)


class Injector:
    """A trouble that does nothing; each kind overrides what it touches. since_s counts from the trouble's beginning, and
    nothing is asked before it. Frames are whole MAVLink frames; an item given back later than now overtakes nothing before.
    """

    needs: Capabilities = Capabilities.NOTHING

    def begin(self, at: InjectionContext) -> None:
        """The trouble begins."""

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Once in each turn of the flight."""

    def end(self, at: InjectionContext) -> None:
        """The flight is over: leave nothing behind."""

    def pose(self, since_s: float, record: PoseRecord) -> Late[PoseRecord]:
        """What becomes of a pose that the tracker delivers now."""
        return [(0.0, record)]

    def depth(self, since_s: float, frame: Depth) -> Late[Depth]:
        """What becomes of a depth frame."""
        return [(0.0, frame)]

    def to_autopilot(self, since_s: float, frame: bytes) -> Late[bytes]:
        """What becomes of a frame of the product."""
        return [(0.0, frame)]

    def to_product(self, since_s: float, frame: bytes) -> Late[bytes]:
        """What becomes of a frame of the autopilot."""
        return [(0.0, frame)]

    def stalls(self, since_s: float, stage: str) -> bool:
        """Whether a stage's loop stands still: mission, perception or pilot."""
        return False

    def restarts(self, since_s: float, stage: str) -> bool:
        """Whether a stage is built anew now; asked once a turn."""
        return False


@dataclass(frozen=True)
class Depth:
    """A depth frame on its way: depth_mm (H, W) uint16, 0 = no return; rgb (h, w, 3) uint8."""

    stamp_s: float
    depth_mm: Any
    rgb: Any
