"""A mesh as binary PLY: float xyz, uchar red green blue, float uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uav_recon.mapping.keyframes import write_whole
from uav_recon.types.maps import TriangleMesh

_VERTEX = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("uncertainty", "<f4")]
)
_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])


def write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Write whole or not at all. Raises OSError if the disk refuses."""
    vertices = np.empty(len(mesh.vertices_world), dtype=_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices_world[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = mesh.rgb[:, channel]
    vertices["uncertainty"] = mesh.uncertainty
    faces = np.empty(len(mesh.faces), dtype=_FACE)
    faces["count"], faces["vertices"] = 3, mesh.faces
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres, world frame: x east, y north, z up",
        f"element vertex {len(vertices)}",
        "property float x",
        "property float y",
        "property float z",
        "property uchar red",
        "property uchar green",
        "property uchar blue",
        "property float uncertainty",
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    write_whole(path, "\n".join(head).encode() + vertices.tobytes() + faces.tobytes())
