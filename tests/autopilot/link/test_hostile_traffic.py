"""Garbage and forged frames on the wire: nothing comes of them. The script beside it does ten megabytes."""

from __future__ import annotations

import pytest
from hostile_traffic import BURST, STATES, bombard, flying, forgeries, frame_of, held_true


@pytest.mark.parametrize("seed", [1, 2])
def test_garbage_and_forged_frames_have_no_effect_and_the_autopilot_is_heard_again_at_once(seed: int) -> None:
    found = bombard(4 * BURST, 80, seed)
    assert found.effects == []
    assert max(found.heard_after_s) <= 0.05
    assert found.waited_bytes < 300


def test_the_same_words_from_the_autopilot_itself_are_taken() -> None:
    """Each forged state is one that would have been believed: the judge is not blind."""
    assert len(forgeries()) >= 60
    for state in STATES:
        link, far = flying()
        before, estimate = held_true(link), link.telemetry.estimate
        far.inbox = frame_of(state)
        link.receive(3.0)
        moved = link.telemetry.estimate is not estimate
        assert moved or far.sent or held_true(link) != before, state
