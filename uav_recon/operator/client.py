"""Client of the command socket: sends one command and receives one answer."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

from uav_recon.operator.status import Status

ANSWER_S = 3.0
_LONGEST_ANSWER = 1 << 16


class CallError(Exception):
    """The pilot cannot be reached; the text is one line with the cause and the remedy."""


def send_command(path: Path, word: str) -> dict[str, Any]:
    """Return the pilot's answer: {"ok", "said"}, and "status" for status.

    Blocks up to a few seconds. Raises CallError.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as pipe:
        pipe.settimeout(ANSWER_S)
        try:
            pipe.connect(str(path))
            pipe.sendall(json.dumps({"do": word}).encode() + b"\n")
            heard = bytearray()
            while not heard.endswith(b"\n") and len(heard) < _LONGEST_ANSWER:
                data = pipe.recv(4096)
                if not data:
                    break
                heard += data
        except PermissionError:
            raise CallError(f"{path}: not allowed: be root, the pilot's user, or in its group") from None
        except TimeoutError:
            raise CallError(f"{path}: the pilot did not answer within {ANSWER_S:.0f} s") from None
        except (FileNotFoundError, ConnectionRefusedError):
            raise CallError(f"{path}: no pilot is running there") from None
        except OSError as error:
            raise CallError(f"{path}: {error.strerror or error}") from None
    try:
        answer = json.loads(heard)
    except ValueError:
        raise CallError(f"{path}: the pilot hung up") from None
    if not _is_the_pilots(answer, word):
        raise CallError(f"{path}: the process that answers there is not the pilot")
    return dict(answer)


def _is_the_pilots(answer: Any, word: str) -> bool:
    if not (isinstance(answer, dict) and isinstance(answer.get("ok"), bool) and isinstance(answer.get("said"), str)):
        return False
    try:
        if word == "status" and answer["ok"]:
            Status.from_json(answer.get("status"))
    except ValueError:
        return False
    return True
