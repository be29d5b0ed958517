from __future__ import annotations

from pathlib import Path

import pytest

from uav_recon import config as configuration
from uav_recon.app.option_validation import UsageError
from uav_recon.app.room_check import MountAdvice, advice_text, advise, check_room

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"


def test_a_mount_that_shows_little_of_a_small_room_is_named_with_the_remedy(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_room("3.4x2.6x2.5", None, None, 0.4) == 1
    assert "set camera.pitch_down_deg = 5" in capsys.readouterr().out
    assert check_room("3.4x2.6x2.5", None, "fixed:5", 0.4) == 0
    assert "it fits" in capsys.readouterr().out
    assert check_room("3.4x2.6x2.5", None, "gimbal", 0.4) == 0


def test_the_config_gives_the_mount(capsys: pytest.CaptureFixture[str]) -> None:
    check_room("8x3x2.5", FLOWN, None, None)
    tilt_deg = configuration.load(FLOWN).camera.pitch_down_deg
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "this mount" in line)
    assert line.split()[0] == f"fixed:{tilt_deg:g}"


@pytest.mark.parametrize("size", ["", "3x3", "3x3x0.1", "axbxc", "3x3x3x3", "3x3xnan"])
def test_a_size_that_is_none_is_an_error(size: str) -> None:
    with pytest.raises(UsageError, match="want length x width x height"):
        check_room(size, None, None, None)


def test_a_mount_that_is_none_is_an_error() -> None:
    with pytest.raises(UsageError, match="--mount fixed:x"):
        check_room("4x3x2.5", None, "fixed:x", None)


def test_the_advice_for_a_config_is_that_for_its_fence() -> None:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["safety"] |= {"fence_min_m": [-1.7, -1.3, -0.1], "fence_max_m": [1.7, 1.3, 2.4], "fence_inset_m": 0.3}
    tree["planner"]["clearance_m"] = 0.4
    advice = advise(configuration.parse(tree, "test"))
    assert advice is not None
    assert (advice.tilt_deg, advice.recommended_deg, advice.fits) == (15.0, 5.0, False)


def test_the_advice_is_one_sentence() -> None:
    assert advice_text(MountAdvice(15.0, 0.81, 5.0, 0.96)) == (
        "a tilt of 15° shows 0.81 of the room, 5° would show 0.96: set camera.pitch_down_deg = 5, or use a gimbal"
    )
