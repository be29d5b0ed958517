"""Processes as a user or systemd meets them: one of each, and an end on SIGTERM.

Each test has its own port.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from typer.testing import CliRunner

from uav_recon import config as configuration
from uav_recon.cli.main import app

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"


@pytest.fixture()
def config(tmp_path: Path) -> Path:
    """Return the flown config with folders and port of this test."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["link"]["url"] = f"udp:127.0.0.1:{port}"
    tree["runtime"]["folder"] = str(tmp_path / "run")
    tree["recording"]["folder"] = str(tmp_path / "flights")
    path = tmp_path / "config.toml"
    configuration.save(configuration.parse(tree, "test"), path)
    return path


def start(name: str, config: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "uav_recon", name, "--config", str(config)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture()
def pilot(config: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    process = start("pilot", config)
    while not list((tmp_path / "flights").glob("*/flight.tlog")):  # the log is created last, just before the loop
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.01)  # leaves the core to the process
    yield process
    process.kill()
    process.communicate()


def test_a_second_pilot_ends_with_exit_code_75_and_the_first_continues(pilot: subprocess.Popen[str], config: Path) -> None:
    second = start("pilot", config)
    _, said = second.communicate(timeout=30)
    assert second.returncode == 75
    assert said.splitlines() == [f"uav-recon: another pilot process already runs in {config.parent / 'run'}"]
    assert pilot.poll() is None


def test_sigterm_on_the_ground_ends_the_pilot_at_once(pilot: subprocess.Popen[str]) -> None:
    pilot.send_signal(signal.SIGTERM)
    _, said = pilot.communicate(timeout=20)
    assert pilot.returncode == 0, said
    assert said == ""


def test_the_pilot_loads_no_heavy_package(pilot: subprocess.Popen[str]) -> None:
    mapped = Path(f"/proc/{pilot.pid}/maps").read_text()
    for package in ("torch", "open3d", "rerun", "cv2", "llvmlite"):
        assert f"/{package}/" not in mapped, package


def test_a_port_in_use_is_a_one_line_error(config: Path) -> None:
    port = int(configuration.load(config).link.url.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        process = start("pilot", config)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 1
    assert len(said.splitlines()) == 1
    assert str(port) in said


def signed(config: Path, mode: int) -> tuple[int, str, Path]:
    """Start a pilot with a key of these permissions and end it once its link is open.

    Returns exit code, error output, and the file of its time stamps.
    """
    key, stamps = config.parent / "signing.key", config.parent / "signing.json"
    key.write_text("correct horse battery\n")
    key.chmod(mode)
    tree = configuration.load(config).model_dump(mode="json", exclude_none=True)
    tree["link"] |= {"autopilot": "ardupilot", "signing_key": str(key), "signing_stamps": str(stamps)}
    configuration.save(configuration.parse(tree, "test"), config)
    process = start("pilot", config)
    while process.poll() is None and not list((config.parent / "flights").glob("*/flight.tlog")):
        time.sleep(0.01)
    process.terminate()
    said = process.communicate(timeout=30)[1]
    return process.returncode, said, stamps


def test_a_pilot_with_a_key_saves_its_signing_time_stamps(config: Path) -> None:
    code, said, stamps = signed(config, 0o600)
    assert (code, said) == (0, "")
    assert json.loads(stamps.read_text())["own"] > 1e13


def test_a_key_that_others_can_read_ends_the_pilot_before_a_byte_is_sent(config: Path) -> None:
    code, said, stamps = signed(config, 0o644)
    key = config.parent / "signing.key"
    assert code == 78
    assert said.splitlines() == [
        f"uav-recon: link.signing_key {key}: permissions 0644, want 0600: others may read or change the key"
    ]
    assert not stamps.exists()


def test_the_recorder_ends_with_its_mission_even_if_that_ended_first(config: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "uav_recon",
        "recorder",
        "--config",
        str(config),
        "--flight",
        str(config.parent / "f"),
    ]
    recorder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert recorder.stdin is not None
    recorder.stdin.close()
    assert recorder.wait(60) == 0
    assert recorder.stderr is not None
    assert recorder.stderr.read() == ""
    recorder.stderr.close()


def say(word: str, config: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uav_recon", *word.split(), "--config", str(config)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_an_operator_gets_the_status_and_the_missing_conditions(pilot: subprocess.Popen[str], config: Path) -> None:
    told = say("status", config)
    assert told.returncode == 0, told.stderr
    lines = told.stdout.splitlines()
    assert lines[:5] == ["pilot     connecting", "mission   silent", "mode      -", "battery   -", "position  -"]
    assert json.loads(say("status --json", config).stdout)["pilot"] == "connecting"
    for word, why in (
        ("start", "not ready: no heartbeat from the autopilot"),
        ("land", "on the ground (connecting): nothing to land"),
    ):
        refused = say(word, config)
        assert (refused.returncode, refused.stderr) == (1, f"uav-recon: {word} refused: {why}\n")
    assert pilot.poll() is None


def test_watching_the_status_ends_on_interrupt_or_with_the_pilot(pilot: subprocess.Popen[str], config: Path) -> None:
    while say("status", config).returncode != 0:
        assert pilot.poll() is None
    command = [sys.executable, "-m", "uav_recon", "status", "--watch", "--config", str(config)]
    first, second = (subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2))
    for watcher in (first, second):
        assert watcher.stdout is not None
        assert [watcher.stdout.readline()[:34] for _ in range(2)] == ["pilot connecting  mission silent  "] * 2
    first.send_signal(signal.SIGINT)
    assert (first.communicate(timeout=20)[1], first.returncode) == ("uav-recon: interrupted\n", 130)
    pilot.kill()
    pilot.communicate()
    *lost, last = second.communicate(timeout=20)[1].splitlines()
    assert (second.returncode, len(lost)) == (69, 2)
    assert last == f"uav-recon: {config.parent / 'run' / 'operator.socket'}: no pilot is running there"


def test_a_missing_pilot_is_reported_to_the_operator(config: Path) -> None:
    told = say("hold", config)
    assert told.returncode == 69
    assert told.stderr == f"uav-recon: {config.parent / 'run' / 'operator.socket'}: no pilot is running there\n"


def test_readiness_and_watchdog_are_reported_to_systemd(config: Path, tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(60.0)
        command = [sys.executable, "-m", "uav_recon", "pilot", "--config", str(config)]
        environment = os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
        try:
            assert systemd.recv(100) == b"READY=1"
            assert [systemd.recv(100) for _ in range(20)] == [b"WATCHDOG=1"] * 20
            process.send_signal(signal.SIGSTOP)  # no other part reports a stalled pilot as alive
            systemd.settimeout(1.0)
            with pytest.raises(TimeoutError):
                while systemd.recv(100) == b"WATCHDOG=1":
                    pass
        finally:
            process.kill()
            process.communicate()


def test_a_ready_pilot_has_locked_its_memory_and_is_small(config: Path, tmp_path: Path) -> None:
    """The memory is locked if this user may lock it; test_memory_lock.py tests the lock."""
    settle = [sys.executable, "-c", "from uav_recon.app import memory_lock as m; print(m.lock_memory_and_freeze_gc())"]
    may = subprocess.run(settle, capture_output=True, text=True, timeout=60, check=True).stdout == "True\n"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(60.0)
        command = [sys.executable, "-m", "uav_recon", "pilot", "--config", str(config)]
        process = subprocess.Popen(command, env=os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify")})
        try:
            assert systemd.recv(100) == b"READY=1"
            assert [systemd.recv(100) for _ in range(100)] == [b"WATCHDOG=1"] * 100
            lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        finally:
            process.kill()
            process.communicate()
    kilobytes = {line.split(":")[0]: int(line.split()[1]) for line in lines if line.endswith(" kB")}
    assert (kilobytes["VmLck"] > 0) == may
    assert kilobytes["VmRSS"] < 150e3


def test_after_a_kill_the_next_pilot_can_start(pilot: subprocess.Popen[str], config: Path) -> None:
    while say("status", config).returncode != 0:
        assert pilot.poll() is None
    pilot.kill()
    pilot.communicate()
    folder = config.parent / "run"
    assert (folder / "operator.socket").is_socket()
    again = start("pilot", config)
    while say("status", config).returncode != 0:
        assert again.poll() is None, again.communicate()[1]
    again.terminate()
    assert again.communicate(timeout=20) == ("", "")
    assert not (folder / "operator.socket").exists()


def perception_of(source: str, config: Path) -> subprocess.Popen[str]:
    tree = configuration.load(config).model_dump(mode="json", exclude_none=True)
    tree["camera"]["source"] = source
    configuration.save(configuration.parse(tree, "test"), config)
    return start("perception", config)


def test_waiting_perception_logs_why_and_ends_on_sigterm(config: Path) -> None:
    process = perception_of("stream", config)
    assert process.stderr is not None
    said = process.stderr.readline()
    assert "waiting for a camera stream" in said
    assert str(config.parent / "run" / "camera.stream") in said
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 0
    assert len(said.splitlines()) == 1, said
    assert "ended while waiting" in said


def test_an_invalid_stream_file_is_reported_at_once(config: Path) -> None:
    (config.parent / "run").mkdir()
    (config.parent / "run" / "camera.stream").write_bytes(b"x" * 5000)
    process = perception_of("stream", config)
    assert process.stderr is not None
    assert "not a camera stream" in process.stderr.readline()
    process.terminate()
    process.communicate(timeout=20)


def test_a_missing_camera_is_reported_before_any_wait(config: Path) -> None:
    process = perception_of("realsense", config)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 1
    assert len(said.splitlines()) == 1, said
    assert "is not connected" in said


def test_a_lock_file_that_cannot_be_opened_is_a_configuration_error(config: Path) -> None:
    (config.parent / "run" / "pilot.lock").mkdir(parents=True)
    process = start("pilot", config)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 78
    assert said == f"uav-recon: {config.parent / 'run' / 'pilot.lock'}: cannot be opened (Is a directory)\n"


@pytest.mark.parametrize("word", ["status", "land"])
@pytest.mark.parametrize(
    "answer",
    [
        {"ok": True},
        {"ok": True, "said": 3},
        {"ok": False},
        {"ok": True, "said": "", "status": {"pilot": "ready", "colour": "red"}},
        {"ok": True, "said": "", "status": {"pilot": "ready"}},
        {"ok": True, "said": "", "status": {"pilot": "ready", "mission": "silent", "battery": "much"}},
        {"ok": True, "said": "", "status": [1]},
    ],
)
def test_a_foreign_process_on_the_operator_socket_is_reported(word: str, answer: dict[str, object], tmp_path: Path) -> None:
    if word == "land" and "status" in answer:
        return  # the land command reads no status
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as desk, ThreadPoolExecutor(1) as foreign:
        desk.bind(str(path))
        desk.listen(1)
        desk.settimeout(30.0)
        answered = foreign.submit(answer_once, desk, answer)
        done = CliRunner().invoke(app, [word, "--socket", str(path)])
        answered.result()
    said = f"uav-recon: {path}: the process that answers there is not the pilot\n"
    assert (done.exit_code, done.stdout, done.stderr) == (69, "", said)


def answer_once(desk: socket.socket, answer: dict[str, object]) -> None:
    connection, _ = desk.accept()
    with connection:
        connection.recv(100)
        connection.sendall(json.dumps(answer).encode() + b"\n")
