"""A viewer that stops, or a port that never reads, neither blocks the recorder nor shortens the recording."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from test_rerun_recorder import fly, rows

from uav_recon.recording import blueprint as names
from uav_recon.recording.live_view import LiveView, shut_connections
from uav_recon.recording.viewer import Viewer

BOUND_S = 3.0  # about two seconds, and some for a busy machine

READER = """
import socket, sys
server = socket.socket(); server.bind(("127.0.0.1", 0)); server.listen(50)
print(server.getsockname()[1], flush=True)
kept = []
while True:
    kept.append(server.accept()[0])
"""

FLIGHT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from test_rerun_recorder import fly
from uav_recon.recording.viewer import Viewer
recorder, _ = fly(Path(sys.argv[1]), duration_s=2.0, live=True, find_viewer=lambda: Viewer(int(sys.argv[2])))
recorder.close()
print("closed", flush=True)
"""


@pytest.fixture
def silent_port() -> Iterator[int]:
    """A port on which the system accepts connections and nobody reads."""
    server = socket.socket()
    server.bind(("127.0.0.1", 0))
    server.listen(50)
    yield server.getsockname()[1]
    server.close()


def test_close_is_bounded_before_a_port_that_never_reads(
    tmp_path: Path, silent_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    recorder, _ = fly(tmp_path, duration_s=6.0, live=True, find_viewer=lambda: Viewer(silent_port))
    begun_s = time.monotonic()
    closing = threading.Thread(target=recorder.close, daemon=True)
    closing.start()
    closing.join(10.0)
    assert not closing.is_alive()
    assert time.monotonic() - begun_s < BOUND_S
    assert rows(tmp_path)[names.SPEED] == 60
    assert caplog.text.count("has not read") == 1


@pytest.fixture
def viewer() -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A process that accepts connections, and its port."""
    process = subprocess.Popen([sys.executable, "-c", READER], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield process, int(process.stdout.readline())
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_stopped_viewer_does_not_keep_the_recorder_from_ending(
    tmp_path: Path, viewer: tuple[subprocess.Popen[str], int]
) -> None:
    process, port = viewer
    process.send_signal(signal.SIGSTOP)
    result = subprocess.run(
        [sys.executable, "-c", FLIGHT, str(tmp_path), str(port), str(Path(__file__).parent)],
        capture_output=True, text=True, timeout=20.0, check=False,
    )  # fmt: skip
    assert result.returncode == 0
    assert result.stdout == "closed\n"
    assert rows(tmp_path)[names.SPEED] == 20


def wait_for_end(view: LiveView) -> None:
    deadline_s = time.monotonic() + 10.0
    while not view.ended and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert view.ended


def test_a_viewer_that_stops_reading_in_flight_ends_the_live_view_once(
    silent_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    import rerun as rr

    view = LiveView(Viewer(silent_port), patience_s=0.3, check_period_s=0.05)
    for _ in range(20):  # more than the buffers of the connection take
        view.stream.log("image", rr.Image(np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)))
    wait_for_end(view)
    begun_s = time.monotonic()
    view.close()
    assert time.monotonic() - begun_s < 0.5
    assert caplog.text.count("has not read for 0.3 s") == 1


def test_a_closed_viewer_ends_the_live_view(
    viewer: tuple[subprocess.Popen[str], int], caplog: pytest.LogCaptureFixture
) -> None:
    process, port = viewer
    view = LiveView(Viewer(port), patience_s=0.3, check_period_s=0.05)
    time.sleep(0.3)  # until the process has the connection
    process.kill()
    wait_for_end(view)
    view.close()
    assert caplog.text.count("was closed") == 1


def test_only_the_connections_to_the_viewer_are_shut(silent_port: int) -> None:
    other = socket.socket()
    other.bind(("127.0.0.1", 0))
    other.listen(1)
    with socket.create_connection(("127.0.0.1", silent_port)) as ours, socket.create_connection(other.getsockname()) as kept:
        assert shut_connections("127.0.0.1", silent_port) == 1
        assert ours.recv(1) == b""
        kept.sendall(b"x")
    other.close()
