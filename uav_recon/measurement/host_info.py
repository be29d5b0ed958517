"""Host information for benchmark results: processor, commit and memory of this process."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import time
from pathlib import Path

# Not part of what is measured: texts, and the results, which a series of measurements writes one after the other.
_NOT_MEASURED = (":(top,exclude)*.md", ":(top,exclude)results")


def processor() -> str:
    """Return the processor name and core count: 'AMD EPYC (AVX2), 2 cores'."""
    return f"{processor_name()}, {os.cpu_count()} cores"


def processor_name() -> str:
    """Return the model name and the vector instructions: 'AMD EPYC (AVX2)'.

    Kernels are compiled for these: they change the rounding, and so a flight.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        flags = next((set(line.split()) for line in lines if line.startswith("flags")), set[str]())
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
    vector = next((text for flag, text in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags), "")
    return f"{name} ({vector})" if vector else name


def commit() -> str:
    """Return the short hash of this source tree, or 'unknown' outside a repository.

    '+changed' is appended if files differ from the commit.
    """
    head, changed = revision()
    return head + ("+changed" if changed else "")


def revision() -> tuple[str, bool]:
    """Return the short hash of this source tree, and whether tracked files differ from it.

    The hash is 'unknown' outside a repository. Texts (*.md) and the folder results/ do not count: they do not change what
    is measured.
    """
    folder = Path(__file__).parent
    head = _git(folder, "rev-parse", "--short", "HEAD")
    if not head:
        return "unknown", False
    return head, bool(_git(folder, "status", "--porcelain", "--untracked-files=no", "--", ":(top)", *_NOT_MEASURED))


def memory_gib() -> float:
    """Return the memory of this machine, GiB."""
    return os.sysconf("SC_PAGESIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30


def resident_mb() -> float:
    """Return the resident memory of this process, in megabytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def process_age_s() -> float:
    """Return the wall time since this process started, in steps of 10 ms."""
    after_name = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    started_s = int(after_name[19]) / os.sysconf("SC_CLK_TCK")  # field 22 of proc(5), since boot
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_s


def _git(folder: Path, *arguments: str) -> str:
    git = shutil.which("git")
    if git is None:
        return ""
    done = subprocess.run([git, "-C", str(folder), *arguments], capture_output=True, text=True, check=False)  # noqa: S603
    return done.stdout.strip() if done.returncode == 0 else ""
