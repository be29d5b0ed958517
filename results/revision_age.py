"""Age of a result in commits, counted over those that touch planner, localization or mapper."""

from __future__ import annotations

import functools
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

from results.claims import ClaimOutcome

MAX_COMMITS = 60
COUNTED = ("uav_recon/planning", "uav_recon/localization", "uav_recon/mapping")


def with_age(outcome: ClaimOutcome, root: Path) -> ClaimOutcome:
    """Return the outcome marked as stale if it is older than MAX_COMMITS, or of a commit that the history does not have."""
    ages = [commits_since(str(header["commit"]), root) for header in outcome.headers]
    return replace(outcome, stale=any(age is None or age > MAX_COMMITS for age in ages))


@functools.cache
def commits_since(commit: str, root: Path) -> int | None:
    """Return the number of counted commits after a commit; None if the history does not have it."""
    git = shutil.which("git")
    if git is None:
        return None
    command = [git, "-C", str(root), "rev-list", "--count", f"{commit}..HEAD", "--", *COUNTED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else None
