"""Worker process that compiles kernels: `python -m uav_recon.app.kernel_worker`.

kernel_cache starts it. Each line on stdin is a job: a JSON list of MODULE:FUNCTION, the path of a config and an argument.
It writes `compiled` to stdout for each compiled kernel, and at the end of a job `done`, or the error in one line. It ends
when stdin is closed.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import queue
import sys
import threading
from pathlib import Path
from typing import IO, Any

from numba.core import event

OURS = ("uav_recon.", "sitl.")


def report_to(replies: IO[str]) -> Any:
    """Return a numba event listener that writes a line for each kernel.

    Kernels that numba compiles for itself are not counted.
    """

    def on_end(_: Any, ended: Any) -> None:
        if ended.data["dispatcher"].py_func.__module__.startswith(OURS):
            replies.write("compiled\n")

    return type("KernelListener", (event.Listener,), {"on_start": lambda *_: None, "on_end": on_end})()


def main() -> None:
    """Run jobs until stdin ends."""
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # a stray print must not break the protocol
    event.register("numba:compile", report_to(replies))
    gc.disable()  # compilation leaves few cycles; searching for them takes a sixth of its time
    jobs: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_read, args=(sys.stdin, jobs), daemon=True).start()
    while True:
        function, config_path, argument = json.loads(jobs.get())
        module, _, name = function.partition(":")
        try:
            getattr(importlib.import_module(module), name)(Path(config_path), argument)
            replies.write("done\n")
        except Exception as error:  # the parent reports it; the process that needs the kernels raises the error itself
            replies.write(f"{type(error).__name__}: {' '.join(str(error).split())}\n")
        gc.collect()


def _read(lines: IO[str], jobs: queue.Queue[str]) -> None:
    for line in lines:
        jobs.put(line)
    os._exit(0)  # the parent has ended or closed stdin: end at once, even during a compilation


if __name__ == "__main__":
    main()
