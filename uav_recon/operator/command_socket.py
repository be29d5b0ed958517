"""Command socket at the pilot: one line of JSON each way, with access checked by the kernel.

It belongs to the pilot, because hold and land must work while the mission is dead. Nothing here blocks or raises on what a
client does: few clients are accepted, slow ones are dropped, long or malformed lines are answered once and dropped.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uav_recon.interfaces import Clock

Answer = dict[str, Any]

MAX_CLIENTS = 4  #: refuse: more clients at once: no client may use up the pilot's descriptors
LONGEST_LINE = 1024  #: refuse: a request of more bytes
PATIENCE_S = 2.0  #: refuse: a client that has not sent its request within this time
_SO_PEERGROUPS = 59  # unix(7); the socket module does not name it
_GROUPS_BYTES = 1024
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid
_LONGEST_PATH = 107


class CommandSocketError(Exception):
    """A socket that cannot be opened; its text is one line that names the path."""


@dataclass(slots=True)
class _Client:
    socket: socket.socket
    since_s: float
    line: bytearray = field(default_factory=bytearray)


class CommandSocket:
    """Listens on a Unix socket of mode 0660. It answers in poll(), to be called every step.

    serve(word) gives the answer. Only this user, root and members of this process's group are accepted. The caller holds a lock
    that makes it the only one with this path: a socket left behind by another is replaced.
    """

    def __init__(self, path: Path, serve: Callable[[str], Answer], clock: Clock) -> None:
        self._path = path
        self._serve = serve
        self._clock = clock
        self._clients: list[_Client] = []
        if len(os.fsencode(path)) > _LONGEST_PATH:
            raise CommandSocketError(f"{path}: longer than the {_LONGEST_PATH} bytes that a socket's path may have")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            path.unlink(missing_ok=True)
            self._socket.bind(str(path))
            path.chmod(0o660)
            self._socket.listen(MAX_CLIENTS)
        except OSError as error:
            self._socket.close()
            raise CommandSocketError(f"{path}: {error.strerror}") from None

    def poll(self) -> None:
        """Accept a client, read from the others, answer complete lines, and drop slow clients."""
        now_s = self._clock.now_s()
        self._accept(now_s)
        for client in list(self._clients):
            if self._hear(client) or now_s - client.since_s > PATIENCE_S:
                client.socket.close()
                self._clients.remove(client)

    def close(self) -> None:
        """Close all connections and remove the socket."""
        for client in self._clients:
            client.socket.close()
        self._clients.clear()
        self._socket.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _accept(self, now_s: float) -> None:
        if len(self._clients) >= MAX_CLIENTS:
            return
        try:
            connection, _ = self._socket.accept()
        except OSError:  # no client, gone already, or no descriptor left
            return
        connection.setblocking(False)
        if _may_speak(connection):
            self._clients.append(_Client(connection, now_s))
        else:
            _say(connection, {"ok": False, "said": "not allowed"})
            connection.close()

    def _hear(self, client: _Client) -> bool:
        """Read what the client sent. Return True if the connection can be closed."""
        try:
            data = client.socket.recv(LONGEST_LINE + 1)
        except BlockingIOError:
            return False
        except OSError:
            return True
        client.line += data
        line, end, _ = client.line.partition(b"\n")
        if not end and data and len(client.line) <= LONGEST_LINE:
            return False
        _say(client.socket, self._answer(bytes(line)) if end and len(line) <= LONGEST_LINE else _NOT_A_LINE)
        return True

    def _answer(self, line: bytes) -> Answer:
        try:
            asked = json.loads(line)
        except (ValueError, RecursionError):
            return _NOT_A_LINE
        word = asked.get("do") if isinstance(asked, dict) else None
        return self._serve(word) if isinstance(word, str) else _NOT_A_LINE


_NOT_A_LINE: Answer = {"ok": False, "said": 'say one line: {"do": "start|hold|return|land|status"}'}


def _may_speak(connection: socket.socket) -> bool:
    """Return True if the other end is this user, root or in this process's group, by the kernel."""
    try:
        raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    except OSError:
        return False
    try:
        groups = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS_BYTES)
    except OSError:  # more groups than fit, or a kernel that does not report them: only the main group counts
        groups = b""
    _, user, group = _CREDENTIALS.unpack(raw)
    return allowed(user, group, struct.unpack(f"{len(groups) // 4}I", groups))


def allowed(user: int, group: int, groups: tuple[int, ...]) -> bool:
    """Return True if this user, main group and further groups may command this process."""
    return user in (0, os.geteuid()) or os.getegid() in (group, *groups)


def _say(connection: socket.socket, answer: Answer) -> None:
    """Send one line, entirely or not at all. It does not wait for a client that does not read."""
    with contextlib.suppress(OSError):
        connection.send(json.dumps(answer).encode() + b"\n")
