"""Measure the duration of shell commands: `python -m results.time_command NAME=COMMAND`.

The commands run one after the other with the working directory at the repository root, or with --clone in a fresh clone of
the commit with an empty cache folder of its own. The JSON file holds the median seconds of each; null if it failed.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from results.claims import ROOT
from uav_recon.bench import result_file


def main(arguments: list[str] | None = None) -> int:
    """Time them, print, write JSON. Returns 1 if a command failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--clone", action="store_true", help="run in a fresh clone of the commit, with an empty cache folder")
    parser.add_argument("--times", type=int, default=1, metavar="N", help="run each command N times")
    parser.add_argument("commands", nargs="+", metavar="NAME=COMMAND")
    options = parser.parse_args(arguments)
    commands = dict(word.split("=", 1) for word in options.commands)
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as name:
        folder, environment = ROOT, {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        if options.clone:
            folder = _clone(Path(name))
            environment = {**os.environ, "XDG_CACHE_HOME": str(Path(name) / "cache")}
            environment.pop("PYTHONPATH", None)
        seconds = {label: _seconds(command, options.times, folder, environment) for label, command in commands.items()}
    for label, took_s in seconds.items():
        print(f"{label}: {'failed' if took_s is None else f'{took_s:.2f} s'}")
    result_file.save(options.json, {"seconds": seconds, "times": options.times, "commands": commands})
    return int(None in seconds.values())


def _clone(folder: Path) -> Path:
    """Clone the repository.

    The optional ../shared stands beside the clone as it does beside the original.
    """
    there = folder / "uav_recon"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(there)], check=True)
    shared = ROOT.parent / "shared"
    if shared.exists():
        (folder / "shared").symlink_to(shared)
    return there


def _seconds(command: str, times: int, folder: Path, environment: dict[str, str]) -> float | None:
    """Return the median wall time of a shell command, None if a run fails."""
    took_s = []
    for _ in range(times):
        began_s = time.monotonic()
        done = subprocess.run(["bash", "-c", command], cwd=folder, env=environment, stdout=subprocess.DEVNULL, check=False)
        if done.returncode:
            return None
        took_s.append(time.monotonic() - began_s)
    return statistics.median(took_s)


if __name__ == "__main__":
    sys.exit(main())
