"""The facts of a step come from the requests, the map, the actions and the limits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from conductor_fixture import Desk, posed_frame, vehicle_state

from uav_recon.mission.detection.event_observation import FRAME_TIMEOUT_S
from uav_recon.mission.events import Event
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

NOW_S = 100.0
VEHICLE = vehicle_state(NOW_S)


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


def test_a_start_waits_for_the_first_map(desk: Desk) -> None:
    observer, maps = desk.conductor._observer, desk.conductor._maps
    desk.conductor.requests.start()
    assert not observer.facts(NOW_S, VEHICLE).start
    desk.channels.frames.publish(posed_frame(NOW_S))
    maps.integrate_frame(NOW_S)
    assert observer.facts(NOW_S, VEHICLE).start


def test_frames_are_lost_after_their_timeout(desk: Desk) -> None:
    observer, maps = desk.conductor._observer, desk.conductor._maps
    maps.frame_s = NOW_S
    assert Event.FRAMES_BACK in observer.events(NOW_S + FRAME_TIMEOUT_S, VEHICLE)
    assert Event.FRAMES_LOST in observer.events(NOW_S + FRAME_TIMEOUT_S + 0.1, VEHICLE)


def test_requests_become_facts(desk: Desk) -> None:
    requests, observer = desk.conductor.requests, desk.conductor._observer
    before = observer.facts(NOW_S, VEHICLE)
    assert not (before.hold or before.go_home or before.abort)
    requests.hold()
    assert observer.facts(NOW_S, VEHICLE).hold
    requests.return_home()
    requests.abort(Reason(ReasonCode.OPERATOR_LAND))
    after = observer.facts(NOW_S, VEHICLE)
    assert not after.hold and after.go_home and after.abort


def test_limits_and_actions_become_facts(desk: Desk) -> None:
    actions, observer = desk.conductor._actions, desk.conductor._observer
    actions.takeoff.begun_s, actions.takeoff.risen, actions.return_home.no_path = NOW_S - 7.0, True, True
    facts = observer.facts(NOW_S, VEHICLE)
    assert (facts.flight_s, facts.max_flight_s, facts.views_left) == (7.0, 300.0, 50)
    assert facts.took_off and facts.no_way_home
    assert not (facts.at_rest or facts.arrived or facts.nothing_left)
