"""Measure the duration of shell commands: `python -m results.time_command NAME=COMMAND`.

The commands run one after the other with the working directory at the repository root, with --clone in a fresh clone of the
commit with an empty cache folder of its own, or with --root in a fresh clone inside another root folder. The JSON file holds
the median seconds of each; null if it failed. With --until it also holds the seconds until the first line of output that
begins with a text. The output goes to stderr.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from results.claims import ROOT
from uav_recon.measurement import result_file


def main(arguments: list[str] | None = None) -> int:
    """Time them, print, write JSON. Returns 1 if a command failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--clone", action="store_true", help="run in a fresh clone of the commit, with an empty cache folder")
    parser.add_argument(
        "--root",
        type=Path,
        metavar="FOLDER",
        help="run in a fresh clone below FOLDER/root, by chroot; needs a system in FOLDER",
    )
    parser.add_argument("--times", type=int, default=1, metavar="N", help="run each command N times")
    parser.add_argument("--until", metavar="TEXT", help="also the time until a line of output begins with TEXT")
    parser.add_argument("commands", nargs="+", metavar="NAME=COMMAND")
    options = parser.parse_args(arguments)
    commands = dict(word.split("=", 1) for word in options.commands)
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as name:
        folder, environment = ROOT, {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        shell = ["bash", "-c"]
        if options.clone or options.root:
            environment = {**os.environ, "XDG_CACHE_HOME": str(Path(name) / "cache")}
            environment.pop("PYTHONPATH", None)
            folder = _clone(options.root / "root" if options.root else Path(name))
        if options.root:
            environment |= {"HOME": "/root", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}
            del environment["XDG_CACHE_HOME"]
            shell = ["/usr/sbin/chroot", str(options.root), "bash", "-c", 'cd ~/uav_recon && eval "$0"']
        runs = {
            label: _timed([*shell, command], options.times, options.until, folder, environment)
            for label, command in commands.items()
        }
    for label, run in runs.items():
        said = "" if run.until_s is None else f", until {options.until!r} {run.until_s:.2f} s"
        print(f"{label}: {'failed' if run.seconds is None else f'{run.seconds:.2f} s'}{said}")
    result = {"seconds": {label: run.seconds for label, run in runs.items()}, "times": options.times, "commands": commands}
    if options.until:
        result["until"] = {label: run.until_s for label, run in runs.items()}
    result_file.save(options.json, result)
    return int(any(run.seconds is None for run in runs.values()))


def _clone(folder: Path) -> Path:
    """Clone the repository.

    The optional ../shared stands beside the clone as it does beside the original.
    """
    there = folder / "uav_recon"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(there)], check=True)
    shared = ROOT.parent / "shared"
    if shared.exists() and not (folder / "shared").exists():
        (folder / "shared").symlink_to(shared)
    return there


@dataclass(frozen=True)
class TimedRun:
    """Median seconds of a command and until its line of output; None if it failed or printed no such line."""

    seconds: float | None
    until_s: float | None


def _timed(command: list[str], times: int, until: str | None, folder: Path, environment: dict[str, str]) -> TimedRun:
    took_s, until_s = list[float](), list[float]()
    for _ in range(times):
        began_s = time.monotonic()
        with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
            for line in process.stdout or ():
                print(line, end="", file=sys.stderr)
                if until and line.startswith(until) and len(until_s) == len(took_s):
                    until_s.append(time.monotonic() - began_s)
        if process.returncode:
            return TimedRun(None, None)
        took_s.append(time.monotonic() - began_s)
    return TimedRun(statistics.median(took_s), statistics.median(until_s) if until_s else None)


if __name__ == "__main__":
    sys.exit(main())
