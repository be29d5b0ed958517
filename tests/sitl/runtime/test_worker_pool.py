"""Worker processes: a Ctrl-C ends them and their children at once and without output."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sitl.runtime.worker_pool import worker_pool

SCRIPT = """
import subprocess, sys, time
from sitl.runtime.worker_pool import worker_pool

if __name__ == "__main__":
    try:
        with worker_pool(2) as hands:
            hands.submit(subprocess.run, ["sleep", "61.5"])
            hands.submit(time.sleep, 60).result()
    except KeyboardInterrupt:
        sys.exit(130)
"""


def of_session(session: int) -> dict[int, str]:
    """Return every live process of a session, with its command line.

    A process that ends releases its memory, and with it its command line, before it is a zombie: it counts as ended.
    """
    lines = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "stat").read_text().rpartition(")")[2].split()
            line = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
        ending = words[0] == "Z" or not line or "resource_tracker" in line  # the tracker ends a moment later
        if int(words[3]) == session and not ending:
            lines[int(folder.name)] = line
    return lines


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_process_is_left_and_nothing_is_printed(tmp_path: Path, number: signal.Signals) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    arguments = [sys.executable, str(script)]
    with subprocess.Popen(arguments, start_new_session=True, stderr=subprocess.PIPE, text=True) as chief:
        check_end(chief, number)


def check_end(chief: subprocess.Popen[str], number: signal.Signals) -> None:
    while "sleep 61.5" not in "".join(of_session(chief.pid).values()):
        assert chief.poll() is None, chief.communicate()[1]
        time.sleep(0.05)
    os.kill(chief.pid, number) if number is signal.SIGKILL else os.killpg(chief.pid, number)
    assert chief.wait(timeout=30) == (130 if number is signal.SIGINT else -9)
    if number is signal.SIGINT:
        assert of_session(chief.pid) == {}
        assert chief.communicate()[1] == ""
        return
    deadline_s = time.monotonic() + 10.0
    while any("python" in line for line in of_session(chief.pid).values()):
        assert time.monotonic() < deadline_s, of_session(chief.pid)
        time.sleep(0.05)
    for left in of_session(chief.pid):  # processes that the workers started without die_with_parent
        os.kill(left, signal.SIGKILL)


def test_results_and_exceptions_of_the_work_are_returned() -> None:
    with worker_pool(2) as hands:
        assert hands.submit(divmod, 7, 3).result() == (2, 1)
        with pytest.raises(ZeroDivisionError):
            hands.submit(divmod, 1, 0).result()


def test_warnings_of_workers_are_not_printed_on_this_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    with worker_pool(1) as hands:
        hands.submit(logging.getLogger("link").warning, "not listened to").result()
    assert capfd.readouterr() == ("", "")
