"""`uav-recon sim --list-scenes`: the scenes that can be flown here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from sitl.scene.scene_kinds import KINDS

SHARED_SCENES = Path("../shared/scenes")  # reference scenes beside the working tree
PIPE_WIDTH = 300  # columns where the output is no terminal: no path is cut
UNKNOWN = "-"


def print_scenes(folder: Path = SHARED_SCENES) -> int:
    """Print a table of the scenes, those in the folder included; returns the exit code."""
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    table = Table("--scene", "what", "size", "licence", box=None, pad_edge=False)
    table.add_row("(none)", "the built-in room, furnished", "8 x 3 x 2.5 m", "Apache-2.0, generated")
    for name, kind in KINDS.items():
        table.add_row(f"{name}:{kind.number}", kind.what, kind.size, "Apache-2.0, generated")
    found = sorted(folder.glob("*/scene.json")) if folder.is_dir() else []
    for description in found:
        table.add_row(str(description.parent), *_described(description))
    console.print(table, highlight=False, markup=False)
    if not found:
        console.print(f"no reference scenes: no folder {folder} with scene.json files", highlight=False, markup=False)
    console.print(
        "any closed mesh in metres, z up: --scene FILE --start X,Y,Z,YAW (.ply .obj .glb .stl)", highlight=False, markup=False
    )
    return 0


def _described(description: Path) -> tuple[str, str, str]:
    """Return the description of a scene, its size and its licence.

    An entry that its scene.json does not contain is `-`.
    """
    try:
        entry: Any = json.loads(description.read_text(encoding="utf-8"))
        words = str(entry.get("description", UNKNOWN)).partition(":")[0]
        area_m2 = entry.get("floor_area_m2")
        size = UNKNOWN if area_m2 is None else f"{float(area_m2):.0f} m²"
        licence = str(entry.get("licence", UNKNOWN)).partition(" (")[0]
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        return f"scene.json cannot be read ({type(error).__name__})", UNKNOWN, UNKNOWN
    return words, size, licence
