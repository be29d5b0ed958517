"""`uav-recon track`: what is missing or does not fit is one line, before anybody waits."""

from __future__ import annotations

from pathlib import Path

import pytest

from uav_recon import config as configuration
from uav_recon.app import track as tracking
from uav_recon.app.track import TrackOptions
from uav_recon.errors import UserError

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"


def _config(folder: Path, **camera: str) -> Path:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["runtime"]["folder"] = str(folder)
    tree["camera"] |= {"source": "stream", **camera}
    configuration.save(configuration.parse(tree, "test"), folder / "config.toml")
    return folder / "config.toml"


@pytest.mark.parametrize(
    ("engine", "weights", "camera", "fault"),
    [
        ("vins", None, {}, "ENGINE vins: want one of orbslam3, cuvslam, droid"),
        ("orbslam3", None, {}, "--weights: want the path of ORBvoc.txt"),
        ("droid", None, {}, "--weights: want the path of droid.pth"),
        ("droid", "missing.pth", {}, "--weights .*missing.pth: cannot be read"),
        ("cuvslam", None, {"source": "realsense"}, "want camera.source and localization.source stream"),
        ("cuvslam", None, {"mount": "gimbal"}, "want camera.mount fixed"),
    ],
)
def test_what_does_not_fit_is_one_line(
    tmp_path: Path, engine: str, weights: str | None, camera: dict[str, str], fault: str
) -> None:
    options = TrackOptions(engine, _config(tmp_path, **camera), None if weights is None else tmp_path / weights)
    with pytest.raises(UserError, match=fault) as failure:
        tracking.track(options, lambda: True)
    assert "\n" not in str(failure.value)
