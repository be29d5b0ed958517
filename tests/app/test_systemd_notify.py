from __future__ import annotations

import socket
from pathlib import Path

import pytest

from uav_recon.app import systemd_notify


@pytest.mark.parametrize("abstract", [False, True])
def test_every_notification_reaches_systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, abstract: bool) -> None:
    name = f"@{tmp_path}/n" if abstract else str(tmp_path / "n")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind("\0" + name[1:] if abstract else name)
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        systemd_notify.ready()
        systemd_notify.watchdog()
        systemd_notify.stopping()
        systemd_notify.extend(3.0)
        heard = [ear.recv(64) for _ in range(4)]
        assert heard == [b"READY=1", b"WATCHDOG=1", b"STOPPING=1", b"EXTEND_TIMEOUT_USEC=3000000"]


def test_without_systemd_no_notification_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    systemd_notify.ready()


def test_a_missing_notify_socket_does_not_stop_the_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    systemd_notify.watchdog()
