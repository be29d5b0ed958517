"""Host information for benchmark results: processor, commit and memory of this process."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path


def processor() -> str:
    """Return the processor name and core count: 'Intel(R) Xeon(R) ..., 2 cores'."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def commit() -> str:
    """Return the short hash of this source tree, or 'unknown' outside a repository.

    '+changed' is appended if files differ from the commit.
    """
    folder = Path(__file__).parent
    head = _git(folder, "rev-parse", "--short", "HEAD")
    if not head:
        return "unknown"
    return head + ("+changed" if _git(folder, "status", "--porcelain", "--untracked-files=no") else "")


def resident_mb() -> float:
    """Return the resident memory of this process, in megabytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def _git(folder: Path, *arguments: str) -> str:
    git = shutil.which("git")
    if git is None:
        return ""
    done = subprocess.run([git, "-C", str(folder), *arguments], capture_output=True, text=True, check=False)  # noqa: S603
    return done.stdout.strip() if done.returncode == 0 else ""
