from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from uav_recon.app import camera_check
from uav_recon.errors import UserError
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader, StreamWriter

LENS = CameraSpec(16, 12, 10.0, 10.0, 7.5, 5.5)


def test_a_running_stream_gets_a_table_and_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "camera.stream"
    writer = StreamWriter(path, StreamHeader(LENS, LENS, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    over = threading.Event()

    def publish() -> None:
        n = 0
        while not over.wait(0.03):
            n += 1
            now_s = time.monotonic()
            writer.write_frame(now_s, np.full((12, 16), 2000 + n % 1000, np.uint16), np.zeros((12, 16, 3), np.uint8))
            writer.write_pose(now_s, np.array([n * 1e-4, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        good = camera_check.check(path, tmp_path / "unused.toml", 1.0)
    finally:
        over.set()
        thread.join()
    out = capsys.readouterr().out
    assert good == 0, out
    assert ", 0 wrong" in out
    assert camera_check.check(path, tmp_path / "unused.toml", 1.0) == 1  # the writer has stopped
    assert "WRONG" in capsys.readouterr().out


def test_what_is_not_a_stream_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "camera.stream"
    path.write_bytes(bytes(5000))
    with pytest.raises(UserError, match="not a camera stream"):
        camera_check.check(path, tmp_path / "unused.toml", 1.0)
    with pytest.raises(UserError, match="outside 1 to 600"):
        camera_check.check(path, tmp_path / "unused.toml", 0.5)
