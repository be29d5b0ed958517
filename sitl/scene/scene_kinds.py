"""Scenes by name: a kind, and a number that draws one of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.scene import floor_plans
from sitl.scene.flat_builder import Start
from sitl.scene.flats_with_doors import flat_with_doors
from sitl.scene.floor_plans import FloorPlan
from sitl.scene.generated_rooms import FLAT, SMALL_ROOM, RoomKind, generated_room
from sitl.scene.mesh import Mesh


@dataclass(frozen=True)
class SceneKind:
    """A kind of scenes.

    draw: gives mesh and start, from the number and whether texture is wanted. what, size: for people. number: what the number
    is. least, most: its range.
    """

    draw: Callable[[int, bool], tuple[Mesh, Start]]
    what: str
    size: str
    number: str = "SEED"
    least: int = 0
    most: int | None = None

    @property
    def range(self) -> str:
        """The allowed numbers, for a message."""
        return f"{self.least} or more" if self.most is None else f"{self.least} to {self.most}"

    def allows(self, number: int) -> bool:
        """Return True if the number is in range."""
        return number >= self.least and (self.most is None or number <= self.most)


def _drawn(kind: RoomKind, what: str, size: str) -> SceneKind:
    return SceneKind(lambda seed, fine: generated_room(seed, fine, kind), what, size)


def _planned(plan: FloorPlan, what: str, size: str) -> SceneKind:
    return SceneKind(plan.build, what, size)


KINDS = {
    "random": _drawn(FLAT, "a generated flat, another for each SEED (0, 1, 2, ...)", "12 to 70 m²"),
    "small": _drawn(SMALL_ROOM, "a generated small room with furniture", "6 to 14 m²"),
    "flat": SceneKind(flat_with_doors, "a generated flat with doors of 0.65 to 1.2 m, some of them half open", "20 to 75 m²"),
    "door": SceneKind(
        lambda width_cm, fine: floor_plans.two_rooms(0.01 * width_cm).build(width_cm, fine),
        "two rooms with a doorway CM wide", "32 m²", "CM", 50, 200,
    ),
    "corridor": _planned(floor_plans.CORRIDOR, "a corridor of 15 x 1.6 m and two rooms behind doors of 0.9 m", "62 m²"),
    "hall": _planned(floor_plans.HALL, "a hall", "12 x 8 x 3.2 m"),
    "l-shape": _planned(floor_plans.L_SHAPE, "a room with a corner", "33 m²"),
    "dead-end": _planned(floor_plans.DEAD_END, "a room and, behind a door of 0.8 m, a corridor that ends", "23 m²"),
    "tall": _planned(floor_plans.TALL, "two rooms 4 m high, a doorway of 0.8 x 2.0 m", "36 m²"),
}  # fmt: skip
