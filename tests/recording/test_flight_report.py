"""Report of a flight without a simulator: it names the values that were not measured."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from uav_recon.recording.flight_log import FlightLog, read_timeline
from uav_recon.recording.flight_report import FlightInfo, build_report, publish
from uav_recon.recording.report import Report, ReportSight
from uav_recon.recording.report_page import verdict
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import MissionProgress

CARD = FlightInfo("kitchen", "adaptive", "px4", "fixed:15")


def progress(stamp_s: float, phase: str, path_m: float) -> MissionProgress:
    return MissionProgress(
        stamp_s, phase, "explore", 1, 60, 9.0, path_m, 2, 2, 1, 0.1, None, False, np.array([stamp_s, 0.0, 1.0])
    )


def flight(folder: Path) -> None:
    log = FlightLog(folder)
    log.phase(9.0, "take-off", None)
    for stamp_s, phase, path_m in ((1.0, "ready", 0.0), (10.0, "survey", 1.0), (30.0, "landing", 8.5), (40.0, "done", 8.5)):
        log.progress(progress(stamp_s, phase, path_m))
    log.plan(12.0, "explore", 0.02, 0.05, 3, 3, 3, 0.2)
    log.plan(20.0, "merged", 0.04, 0.07, 1, 5, 4, 0.3)
    log.view(13.0, 1, Pose.identity())
    log.refusal(14.0, Reason(ReasonCode.MAP_BLOCKS_PATH))
    log.outcome(40.0, None, Reason(ReasonCode.NO_FRONTIERS_LEFT))
    frames = ((ReasonCode.DEPTH_FRAME_EMPTY, 2),)
    log.perception(PerceptionStatus(20.0, 150, frames[:0], (("jump", 1),)))
    log.perception(
        PerceptionStatus(
            40.0,
            300,
            frames,
            (("jump", 1), ("imu stamp", 5)),
            Reason(ReasonCode.DEPTH_FRAME_EMPTY, (0.0,)),
            39.0,
            calibration=(("delay_s", 0.028, 0.006),),
            camera=(Reason(ReasonCode.CAMERA_USB2, ("2.1", "15")), Reason(ReasonCode.CAMERA_WITHOUT_IMU)),
        )
    )
    log.refused_views(41.0, {"no depth": 3, "memory is full": 1})
    log.close()


def test_a_real_flight_gets_a_report(tmp_path: Path) -> None:
    flight(tmp_path)
    publish(build_report(tmp_path, CARD, wall_s=55.0), tmp_path)
    report = Report.load(tmp_path / "report.json")
    assert (report.scene, report.outcome, report.stop_reason) == ("kitchen", "completed", "no frontiers left")
    assert (report.views, report.path_length_m, report.flight_time_s) == (1, 8.5, 20.0)
    assert report.planning.explore.step_s.median == 0.05
    assert report.planning.merged.task_s.p95 == 0.04
    assert abs(report.planning.total_s - 0.12) < 1e-9
    assert abs(report.planning.hover_wait_s - 0.5) < 1e-9
    assert (report.last_view_s, report.recall_over_time) == (4.0, None)
    assert report.time_to_recall_s == {"0.90": None, "0.95": None}
    assert report.quality is None
    assert report.safety.contacts is None
    assert report.safety.refusals == 1
    assert report.refused_views == {"no depth": 3, "memory is full": 1}
    assert report.camera_calibration == {"delay_s": (0.028, 0.006)}
    assert len(report.camera) == 2
    assert "the camera is on USB 2.1: 15 frames a second" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert report.rejected_by_perception == {"depth-frame-empty": 2, "imu stamp": 5, "pose jump": 1}
    assert "not measured" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_waiting_counts_from_take_off_to_the_last_view(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.phase(10.0, "take-off", None)
    for stamp_s, waited_s in ((10.5, 2.0), (20.0, 1.0), (30.4, 0.5), (40.0, 3.0)):  # half a second of the first and 0.1 of the
        log.plan(stamp_s, "explore", 0.0, 0.0, 1, 1, 1, waited_s)  # third lie within, nothing of the last
    log.view(30.0, 1, Pose.identity())
    log.close()
    report = build_report(tmp_path, CARD, 1.0)
    assert report.last_view_s == 20.0
    assert report.waiting_share == pytest.approx((0.5 + 1.0 + 0.1) / 20.0)


def test_what_only_a_simulator_knows_is_not_given(tmp_path: Path) -> None:
    FlightLog(tmp_path).close()
    report = build_report(tmp_path, CARD, 1.0)
    assert (report.safety.contacts, report.safety.failsafes, report.stream.rate_hz) == (None, None, None)
    publish(report, tmp_path)
    assert "<th>Failsafes of the autopilot</th><td>–</td>" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_without_a_view_there_is_no_waiting_share(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.phase(10.0, "take-off", None)
    log.close()
    assert build_report(tmp_path, CARD, 1.0).waiting_share is None


def test_a_mission_without_an_outcome_is_reported_as_aborted(tmp_path: Path) -> None:
    report = build_report(tmp_path, CARD, wall_s=1.0)
    assert report.outcome == "aborted: the mission left no word"
    assert report.flight_time_s == 0.0
    assert (report.last_view_s, report.waiting_share) == (None, None)


def test_the_time_at_reduced_speed_is_counted_by_reason_and_within_the_flight(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.speed_limit(5.0, 0.3, Reason(ReasonCode.NO_IMU))  # ten seconds before the flight
    log.phase(15.0, "take-off", None)
    log.progress(progress(15.0, "take-off", 0.0))
    log.speed_limit(20.0, math.inf, None)
    log.speed_limit(30.0, 0.3, Reason(ReasonCode.FEW_POSES, (7.0,)))
    log.speed_limit(32.0, 0.3, Reason(ReasonCode.NO_IMU))
    log.speed_limit(33.0, 0.3, Reason(ReasonCode.FEW_POSES, (5.0,)))  # to the end
    log.progress(progress(40.0, "landing", 8.5))
    log.close()
    report = build_report(tmp_path, CARD, 1.0)
    assert report.reduced_speed_s == {"no inertial samples": 6.0, "7 poses a second": 9.0}
    limits = read_timeline(tmp_path).speed_limits
    assert [(limit.max_speed_mps, limit.codes) for limit in limits[:2]] == [(0.3, ("no-imu",)), (None, ())]


Sight = tuple[float, str, float | None, float | None]  # stamp, phase, predicted and measured uncertainty of the place


def sight(folder: Path, samples: Iterable[Sight]) -> ReportSight | None:
    log = FlightLog(folder)
    for stamp_s, phase, predicted_m, measured_m in samples:
        now = progress(stamp_s, phase, 0.0)
        log.progress(dataclasses.replace(now, predicted_sigma_m=predicted_m, measured_sigma_m=measured_m))
    log.close()
    return build_report(folder, CARD, 1.0).sight


def test_the_time_in_which_the_view_shows_the_place_badly_is_counted_in_the_air(tmp_path: Path) -> None:
    found = sight(
        tmp_path,
        (
            (0.0, "ready", 1.0, 0.5),  # on the ground
            (1.0, "take-off", 0.003, 0.011),
            (1.5, "survey", 0.005, 0.030),  # half a second
            (2.0, "survey", 0.013, 0.050),  # 0.75 s
            (2.75, "survey", 0.003, 0.011),
            (3.0, "retreat", 0.020, 0.060),  # half a second and ...
            (3.5, "survey", None, 0.045),  # ... the same
            (4.0, "survey", 0.003, None),
            (4.5, "return", 0.003, 0.041),  # the mission process was down for longer than it counts
            (9.5, "landing", 0.003, 0.011),
            (10.0, "done", 1.0, 0.5),
            (10.5, "done", 1.0, 0.5),
        ),
    )
    assert found is not None
    assert found.weak_s == pytest.approx(0.5 + 0.75 + 0.5 + 0.5 + 1.0)
    assert found.blind_s == pytest.approx(0.75 + 0.5 + 0.5 + 1.0)
    assert found.longest_blind_s == pytest.approx(1.0)
    assert found.predicted_weak_s == pytest.approx(0.5 + 0.75 + 0.5)
    assert found.predicted_blind_s == pytest.approx(0.75 + 0.5)


def test_the_longest_stretch_is_not_the_sum_of_all(tmp_path: Path) -> None:
    measured_m = (0.05, 0.05, 0.01, 0.05, 0.05, 0.05, 0.01)
    found = sight(tmp_path, ((0.25 * n, "survey", 0.001, sigma_m) for n, sigma_m in enumerate(measured_m)))
    assert found is not None
    assert found.blind_s == pytest.approx(1.25)
    assert found.longest_blind_s == pytest.approx(0.75)


def test_without_predictions_in_the_air_nothing_is_said_of_the_sight(tmp_path: Path) -> None:
    samples: tuple[Sight, ...] = ((0.0, "ready", 0.1, 0.1), (1.0, "survey", None, 0.05), (2.0, "survey", None, 0.05))
    assert sight(tmp_path, samples) is None
    publish(build_report(tmp_path, CARD, 1.0), tmp_path)
    assert not (tmp_path / "pictures" / "place.png").exists()
    assert "Uncertainty of the place" not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_sight_that_was_predicted_but_not_measured_has_no_measured_times(tmp_path: Path) -> None:
    found = sight(tmp_path, ((1.0, "survey", 0.02, None), (1.5, "survey", 0.001, None)))
    assert found == ReportSight(None, None, None, 0.5, 0.5)
    publish(build_report(tmp_path, CARD, 1.0), tmp_path)
    assert Report.load(tmp_path / "report.json").sight == found
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<th>Above 2 cm</th><td>–</td>" in page
    assert (tmp_path / "pictures" / "place.png").exists()
    assert page.count("How well the place was known, and how well the view should show it.</figcaption>") == 1


PLACES = Reason(ReasonCode.PLACES_LEFT_UNSEEN, (2,), (Reason(ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT, (2,)),))
SPENT = Reason(ReasonCode.VIEWS_SPENT, (40,))


@pytest.mark.parametrize(
    ("stop_reason", "headline"),
    [
        (None, "completed"),
        (Reason(ReasonCode.NO_FRONTIERS_LEFT), "completed"),
        (Reason(ReasonCode.FRONTIERS_LEFT, (9,), (Reason(ReasonCode.FRONTIERS_TOO_NARROW, (9,)),)), "completed"),
        (PLACES, "completed, 2 place(s) left unseen"),
        (SPENT.with_detail(Reason(ReasonCode.FRONTIERS_IN_LAST_PLAN, (12,))),
         "completed, view budget of 40 spent, 12 frontiers left in the last plan"),
        (SPENT.with_detail(Reason(ReasonCode.FRONTIERS_IN_LAST_PLAN, (0,))), "completed, view budget of 40 spent"),
        (Reason(ReasonCode.PLANS_FAILED, (5,), (Reason(ReasonCode.NO_KNOWN_PATH),)), "completed, 5 plans in a row not flyable"),
    ],
)  # fmt: skip
def test_the_headline_says_what_ended_a_flight_before_everything_was_seen(
    tmp_path: Path, stop_reason: Reason | None, headline: str
) -> None:
    log = FlightLog(tmp_path)
    log.outcome(40.0, None, stop_reason)
    log.close()
    report = build_report(tmp_path, CARD, wall_s=55.0)
    assert report.completed, "frontiers that are left do not make it an aborted flight"
    assert report.headline == headline
    title, mood = verdict(report)
    assert (title.lower(), mood) == (headline, "good" if headline == "completed" else "fair")
    assert report.stop_reason == ("" if stop_reason is None else stop_reason.text())


def test_an_aborted_flight_says_why_it_was_aborted_and_no_more(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.outcome(40.0, Reason(ReasonCode.OPERATOR_LAND), PLACES)
    log.close()
    report = build_report(tmp_path, CARD, wall_s=55.0)
    assert report.headline == report.outcome == f"aborted: {Reason(ReasonCode.OPERATOR_LAND).text()}"
