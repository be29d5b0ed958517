"""Stamps over restarts, crashes and wall clocks that were set."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uav_recon.autopilot.mavlink.signing_timestamps import LATE_S, UNITS_PER_S, SigningTimestamps, SigningTimestampsError
from uav_recon.clock import InlineExecutor, ManualClock

NOW_S = 1_795_000_000.0  # 2026
SINCE_2015 = int((NOW_S - 1420070400) * UNITS_PER_S)
VEHICLE = (0, 1, 1)


def stamps(path: Path, wall_s: float = NOW_S, now_s: float = 100.0) -> SigningTimestamps:
    return SigningTimestamps(path, wall_s, now_s, InlineExecutor(ManualClock()))


def test_they_count_tens_of_microseconds_since_2015(tmp_path: Path) -> None:
    ours = stamps(tmp_path / "stamps")
    assert [ours.next(100.0), ours.next(100.0), ours.next(101.0)] == [SINCE_2015, SINCE_2015 + 1, SINCE_2015 + UNITS_PER_S]
    assert ours.next(90.0) == SINCE_2015 + UNITS_PER_S + 1


@pytest.mark.parametrize("wall_s", [NOW_S, NOW_S + 1.0, NOW_S - 3600.0, 0.0], ids=["same", "later", "an hour back", "1970"])
@pytest.mark.parametrize("flown_s", [0.0, 3.0, 4.99, 60.0, 301.7])
def test_no_stamp_is_used_twice_after_a_crash(tmp_path: Path, wall_s: float, flown_s: float) -> None:
    before = stamps(tmp_path / "stamps")
    used = [before.next(100.0 + 0.03 * turn) for turn in range(int(flown_s / 0.03) + 1)]
    after = stamps(tmp_path / "stamps", wall_s, now_s=7.0)
    assert after.next(7.0) > max(used)


def test_a_vehicle_far_ahead_takes_us_along_and_a_crash_does_not_bring_us_back(tmp_path: Path) -> None:
    before = stamps(tmp_path / "stamps")
    before.note(VEHICLE, SINCE_2015 + 3600 * UNITS_PER_S)
    used = before.next(100.1)
    assert used == SINCE_2015 + 3600 * UNITS_PER_S + 1
    assert stamps(tmp_path / "stamps").next(100.0) > used


def test_the_end_leaves_nothing_ahead(tmp_path: Path) -> None:
    ours = stamps(tmp_path / "stamps")
    last = ours.next(130.0)
    ours.close()
    assert stamps(tmp_path / "stamps", 0.0).next(100.0) == last + 1


def test_the_file_is_written_rarely(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, written = stamps(tmp_path / "stamps"), 0
    replace = Path.replace

    def count(self: Path, target: Path) -> Path:
        nonlocal written
        written += 1
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", count)
    for turn in range(6000):
        ours.next(100.0 + turn * 0.01)
    assert 10 <= written <= 13


def test_an_older_frame_is_not_new_not_even_after_a_restart(tmp_path: Path) -> None:
    ours = stamps(tmp_path / "stamps")
    ours.next(100.0)
    assert ours.is_new(VEHICLE, SINCE_2015 + 50)
    ours.note(VEHICLE, SINCE_2015 + 50)
    assert [ours.is_new(VEHICLE, SINCE_2015 + n) for n in (49, 50, 51)] == [False, False, True]
    assert ours.next(100.0) == SINCE_2015 + 51, "ours come after what we believed"
    ours.close()
    again = stamps(tmp_path / "stamps")
    assert [again.is_new(VEHICLE, SINCE_2015 + n) for n in (49, 50, 51)] == [False, False, True]


def test_a_sender_not_heard_before_may_be_a_minute_late(tmp_path: Path) -> None:
    ours = stamps(tmp_path / "stamps")
    now = ours.next(100.0)
    border = now - int(LATE_S * UNITS_PER_S)
    assert [ours.is_new(VEHICLE, border + n) for n in (-1, 0, 1)] == [False, True, True]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "not the stamps"),
        ("{}", "not the stamps"),
        ('{"own": 1, "heard": [[1, 2]]}', "not the stamps"),
        (json.dumps({"own": 1 << 48, "heard": []}), "0 to 2\\*\\*48 - 1"),
        (json.dumps({"own": 1, "heard": [[0, 1, 1, -1]]}), "0 to 2\\*\\*48 - 1"),
    ],
)
def test_a_file_that_cannot_be_believed_is_one_line(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "stamps").write_text(content)
    with pytest.raises(SigningTimestampsError, match=rf"^signing_stamps {tmp_path}/stamps: .*{says}"):
        stamps(tmp_path / "stamps")


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SigningTimestampsError, match=r"none/stamps: cannot be written \(No such file or directory\)"):
        stamps(tmp_path / "none" / "stamps")


def test_a_disk_that_fails_in_flight_does_not_end_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    ours = stamps(folder / "stamps")
    (folder / "stamps").unlink()
    folder.rmdir()
    used = [ours.next(100.0 + s) for s in range(20)]
    assert sorted(set(used)) == used
    assert "cannot be written" in caplog.text
