"""Run the commands of claims.toml: `python -m results.measure [--long] [RUN ...]`.

Each writes its JSON file. Without RUN: all short ones, or with --long all long ones. The old file of a run is removed
before it starts, so that no figure of another commit stays behind. Exit code 1 if a run wrote no file. `make results`
writes the pages afterwards.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping

from results.claims import ROOT, Run, load_claims

TOOLS = {"uav-recon": ("-m", "uav_recon"), "python": ()}  # what runs with this interpreter and this source tree


def main(arguments: list[str] | None = None) -> int:
    """Measure, one line for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--long", action="store_true", help="the runs marked long")
    parser.add_argument("--list", action="store_true", help="print the commands only")
    parser.add_argument("runs", nargs="*", metavar="RUN")
    options = parser.parse_args(arguments)
    _, known = load_claims()
    unknown = [name for name in options.runs if name not in known]
    if unknown:
        parser.error(f"no run {', '.join(unknown)}; there are {', '.join(known)}")
    runs = [known[name] for name in options.runs] or [run for run in known.values() if run.long == options.long]
    print(f"{len(runs)} runs, about {sum(run.minutes for run in runs):.0f} minutes on two idle cores", flush=True)
    failed = []
    for run in runs:
        print(f"{run.name}: {run.command_line}", flush=True)
        if not options.list and not _measure(run, os.environ):
            failed.append(run.name)
    if failed:
        print(f"no result: {', '.join(failed)}")
    return int(bool(failed))


def _measure(run: Run, environment: Mapping[str, str]) -> bool:
    """Run one command; returns whether its file is there, or a firmware that it needs is not."""
    missing = [name for name in re.findall(r"\$(\w+)", run.command) if not environment.get(name)]
    if missing:
        print(f"  skipped: {', '.join(missing)} is not set", flush=True)
        return True
    path = ROOT / run.path
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    began_s = time.monotonic()
    command = shell_command(run.command_line)
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, env={**environment, "PYTHONPATH": str(ROOT)}, check=False)
    written = path.exists()
    said = "written" if written else "NOT written"
    print(f"  exit code {done.returncode}, {time.monotonic() - began_s:.0f} s, {run.path} {said}", flush=True)
    return written


def shell_command(line: str) -> str:
    """Return a command of claims.toml with its program replaced by this interpreter.

    Only the programs in TOOLS are replaced.
    """
    program, _, rest = line.partition(" ")
    if program == "make":
        return f"make PYTHON={sys.executable} {rest}"
    return line if program not in TOOLS else " ".join([sys.executable, *TOOLS[program], rest])


if __name__ == "__main__":
    sys.exit(main())
