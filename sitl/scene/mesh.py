"""Triangle meshes with a colour per vertex, and their file reader."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]
GREY = 160
MESH_SUFFIXES = (".ply", ".obj", ".glb", ".stl")


class MeshError(Exception):
    """The file cannot be read as a mesh; the message is one line."""


@dataclass(frozen=True)
class Mesh:
    """A mesh in the frame of its file: vertices (V, 3) m, z up; faces (F, 3); rgb (V, 3)."""

    vertices: F32
    faces: I32
    rgb: U8


def read_mesh(file: Path) -> Mesh:
    """Read a mesh with its vertex, face or texture colours, grey without. Raises MeshError."""
    import trimesh

    if file.suffix.lower() not in MESH_SUFFIXES:
        raise MeshError(f"{file}: not a mesh file ({', '.join(MESH_SUFFIXES)})")
    try:
        loaded = trimesh.load_scene(str(file), process=False)
        parts = [_part(geometry) for geometry in loaded.dump() if isinstance(geometry, trimesh.Trimesh)]
    except Exception as error:  # trimesh's readers pass on the exceptions of their parsers
        has_text = isinstance(error, OSError | ValueError) and str(error)
        reason = str(error).splitlines()[0] if has_text else "damaged, or of another kind"
        raise MeshError(f"{file}: cannot be read as a mesh ({reason})") from None
    if not any(len(part.faces) for part in parts):
        raise MeshError(f"{file}: the mesh is empty")
    return joined(parts)


def joined(parts: list[Mesh]) -> Mesh:
    """Return one mesh that contains all parts."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)])
    vertices, rgb = np.concatenate([part.vertices for part in parts]), np.concatenate([part.rgb for part in parts])
    return Mesh(vertices.astype(np.float32), np.ascontiguousarray(faces, np.int32), rgb.astype(np.uint8))


def _part(geometry: Any) -> Mesh:
    vertices, faces = np.asarray(geometry.vertices), np.asarray(geometry.faces)
    kind = geometry.visual.kind
    if kind == "face":
        rgb = np.repeat(np.asarray(geometry.visual.face_colors)[:, :3], 3, axis=0)
        return Mesh(vertices[faces.ravel()].astype(np.float32), np.arange(faces.size, dtype=np.int32).reshape(-1, 3), rgb)
    if kind == "texture":
        rgb = np.asarray(geometry.visual.to_color().vertex_colors)[:, :3]
    elif kind == "vertex":
        rgb = np.asarray(geometry.visual.vertex_colors)[:, :3]
    else:
        rgb = np.full((len(vertices), 3), GREY, np.uint8)
    if len(rgb) != len(vertices):  # a texture that could not be found comes back as one colour
        rgb = np.broadcast_to(rgb[:1], (len(vertices), 3)) if len(rgb) else np.full((len(vertices), 3), GREY, np.uint8)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), np.ascontiguousarray(rgb, np.uint8))
