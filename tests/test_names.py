"""One public class, one name: no two modules of the tree define public classes of the same name."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]


def public_classes(*folders: str) -> dict[str, list[str]]:
    """Return the modules that define each public class at module level, by the name of the class."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(str(path.relative_to(ROOT)))
    return found


def test_no_two_public_classes_share_a_name() -> None:
    classes = public_classes("uav_recon", "sitl")
    assert len(classes) > 500
    assert {name: where for name, where in classes.items() if len(where) > 1} == {}
