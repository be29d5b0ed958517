"""Version of this program: that of the package, and the commit.

The commit is the one that it was installed from or runs in.
"""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path

from uav_recon.measurement import host_info

PACKAGE = "uav-recon"
_SOURCE = Path(__file__).parents[2]


def version_line() -> str:
    """Return `uav-recon VERSION`, with the commit where it is known."""
    try:
        package = metadata.distribution(PACKAGE)
    except metadata.PackageNotFoundError:
        return f"{PACKAGE} (not installed)"
    in_working_tree = (_SOURCE / ".git").exists()  # an installed copy may lie inside another repository
    commit = host_info.commit() if in_working_tree else _installed_commit(package)
    return f"{PACKAGE} {package.version}" + ("" if commit in ("", "unknown") else f" (commit {commit})")


def _installed_commit(package: metadata.Distribution) -> str:
    """Return the commit that pip recorded for an installation from a repository.

    It is "" for any other installation.
    """
    try:
        return str(json.loads(package.read_text("direct_url.json") or "{}")["vcs_info"]["commit_id"])[:7]
    except (ValueError, KeyError, TypeError):
        return ""
