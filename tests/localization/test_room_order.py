"""Order of the rooms of localization: each imports only those below it."""

from __future__ import annotations

import ast
from pathlib import Path

import uav_recon.localization

ROOT = Path(uav_recon.localization.__file__).parent
LEVEL = {
    "calibration": 1,
    "flow": 1,
    "fusion": 1,
    "pad_origin": 1,
    "repeated_image": 1,
    "slam": 2,
    "motion_estimator": 2,
    "consistency": 3,
    "correction": 3,
    "exclusion": 3,
    "hand_calibration": 4,
    "perception": 4,
}


def _room(name: str) -> str | None:
    """Return the room of a module of localization, None for another module."""
    return name.split(".")[2] if name.startswith("uav_recon.localization.") else None


def _imported_rooms(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = {f"{node.module}.{alias.name}" for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names}
    names |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return {room for name in names if (room := _room(name)) is not None}


def test_each_room_imports_only_rooms_below_it() -> None:
    paths = [path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py"]
    assert {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in paths} == set(LEVEL)
    for path in paths:
        room = path.relative_to(ROOT).parts[0].removesuffix(".py")
        for other in _imported_rooms(path) - {room}:
            assert LEVEL[other] < LEVEL[room], f"{path.relative_to(ROOT)} imports {other}"
