"""World process in real time: its growing records must not stall it for hours of flight."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from sitl.apps import world_process


class NotesDown:
    """Stub world that records as much in a few steps as a real one in an hour."""

    def __init__(self) -> None:
        self.notes: list[tuple[object, ...]] = []

    def step(self, now_s: float) -> None:
        self.notes += [([now_s],) for _ in range(2000)]

    def frame_due(self, now_s: float) -> bool:
        return False


class NoDarkroom:
    def __init__(self, world: NotesDown) -> None:
        self.world = world

    def close(self) -> None:
        pass


@pytest.fixture
def collections() -> Iterator[list[int]]:
    """Yield the list of the generations of garbage collections from here on."""
    seen, thresholds = list[int](), gc.get_threshold()

    def note(phase: str, about: dict[str, int]) -> None:
        if phase == "start":
            seen.append(about["generation"])

    gc.collect()
    gc.callbacks.append(note)
    yield seen
    gc.callbacks.remove(note)
    gc.set_threshold(*thresholds)
    gc.unfreeze()


def test_a_long_flight_never_runs_a_full_garbage_collection(collections: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_process, "RenderThread", NoDarkroom)
    world = NotesDown()
    world_process.run(world, lambda _: len(world.notes) >= 400_000)  # type: ignore[arg-type]
    assert collections.count(0) > 100
    assert 2 not in collections
