"""The operator's socket: one line each way, and no client hurts the one that polls."""

from __future__ import annotations

import json
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_recon.clock import ManualClock
from uav_recon.operator.client import CallError, send_command
from uav_recon.operator.command_socket import LONGEST_LINE, MAX_CLIENTS, PATIENCE_S, CommandSocket, CommandSocketError, allowed


class Office:
    """A desk and what it was asked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.clock = ManualClock()
        self.words = list[str]()
        self.desk = CommandSocket(path, self._serve, self.clock)

    def _serve(self, word: str) -> dict[str, Any]:
        self.words.append(word)
        return {"ok": True, "said": f"heard {word}"}

    def client(self, data: bytes = b"") -> socket.socket:
        pipe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        pipe.settimeout(5.0)
        pipe.connect(str(self.path))
        pipe.sendall(data)
        return pipe

    def turns(self, count: int = 6, seconds: float = 0.01) -> None:
        for _ in range(count):
            self.clock.advance_to(self.clock.now_s() + seconds)
            self.desk.poll()

    def answer_to(self, data: bytes) -> Any:
        with self.client(data) as pipe:
            self.turns()
            heard = pipe.recv(4096)
            assert pipe.recv(1) == b"", "it hangs up"
        return json.loads(heard)


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Office]:
    office = Office(tmp_path_factory.mktemp("desk") / "operator.socket")
    yield office
    office.desk.close()
    assert not office.path.exists()


def test_a_word_is_answered(office: Office) -> None:
    assert office.answer_to(b'{"do": "hold"}\n') == {"ok": True, "said": "heard hold"}
    assert office.words[-1] == "hold"


def test_a_line_may_come_in_pieces(office: Office) -> None:
    with office.client() as pipe:
        for byte in b'{"do": "land"}\n':
            pipe.sendall(bytes([byte]))
            office.turns(1)
        assert json.loads(pipe.recv(4096))["said"] == "heard land"


def test_only_the_user_and_the_group_may_reach_it(office: Office) -> None:
    assert stat.S_IMODE(office.path.stat().st_mode) == 0o660


def test_who_is_allowed() -> None:
    us, ours, other = os.geteuid(), os.getegid(), 54321
    assert allowed(us, other, ())
    assert allowed(0, other, ())
    assert allowed(other, ours, ())
    assert allowed(other, other, (7, ours))
    assert not allowed(other, other, (7, 8))


def test_a_stranger_is_turned_away_unheard(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.operator.command_socket._may_speak", lambda connection: False)
    before = len(office.words)
    with office.client(b'{"do": "land"}\n') as pipe:
        office.turns()
        assert json.loads(pipe.recv(4096)) == {"ok": False, "said": "not allowed"}
    assert len(office.words) == before


@pytest.mark.parametrize(
    "line",
    [
        b"land\n", b"\n", b"[]\n", b"{}\n", b'{"do": 3}\n', b'{"do": null}\n', b"\xff\xfe\n", b"[" * 1000 + b"\n",
        b'{"do": "land"', b"x" * (LONGEST_LINE + 1), b'{"do": "land", "x": "' + b"y" * LONGEST_LINE + b'"}\n',
    ],
)  # fmt: skip
def test_nonsense_and_long_lines_are_refused_once(office: Office, line: bytes) -> None:
    before = len(office.words)
    with office.client(line) as pipe:
        pipe.shutdown(socket.SHUT_WR)
        office.turns()
        assert json.loads(pipe.recv(4096))["ok"] is False
    assert len(office.words) == before


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=3 * LONGEST_LINE))
def test_no_bytes_raise_or_stay(office: Office, data: bytes) -> None:
    with office.client() as pipe:
        pipe.setblocking(False)
        pipe.send(data)
        office.turns(3)
    office.turns(3)
    assert office.answer_to(b'{"do": "status"}\n')["ok"]


def test_the_slow_are_dropped_and_keep_nobody_out_for_long(office: Office) -> None:
    slow = [office.client(b"{") for _ in range(MAX_CLIENTS)]
    office.turns(MAX_CLIENTS)
    with office.client(b'{"do": "hold"}\n') as pipe:
        pipe.setblocking(False)
        office.turns(20)
        with pytest.raises(BlockingIOError):
            pipe.recv(1)
        office.turns(2, seconds=PATIENCE_S)
        office.turns()
        assert json.loads(pipe.recv(4096))["said"] == "heard hold"
    for one in slow:
        assert one.recv(1) == b""
        one.close()


def test_who_hangs_up_at_once_is_no_trouble(office: Office) -> None:
    for data in (b"", b'{"do": "hold"}\n'):
        for _ in range(20):
            office.client(data).close()
            office.turns(2)
    assert office.answer_to(b'{"do": "status"}\n')["ok"]


def test_no_descriptor_is_left_behind(office: Office) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(50):
        office.answer_to(b'{"do": "status"}\n')
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_socket_left_by_a_pilot_that_was_killed_is_replaced(tmp_path: Path) -> None:
    first = Office(tmp_path / "s")
    first.desk._socket.close()  # as kill -9 leaves it: the file stays
    again = Office(tmp_path / "s")
    assert again.answer_to(b'{"do": "status"}\n')["ok"]
    again.desk.close()


def test_a_path_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    for path, fault in ((tmp_path / "no" / "s", "No such file"), (tmp_path / ("x" * 108), "107 bytes")):
        with pytest.raises(CommandSocketError, match=fault):
            CommandSocket(path, lambda word: {}, ManualClock())


def test_a_call_without_a_pilot_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CallError, match="no pilot is running there"):
        send_command(tmp_path / "operator.socket", "status")
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(str(tmp_path / "dead"))
    dead.close()
    with pytest.raises(CallError, match="no pilot is running there"):
        send_command(tmp_path / "dead", "status")
