"""Writer of binary PLY meshes.

Vertices: float xyz, uchar red green blue, float uncertainty. Faces of a closed mesh: uchar observed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uav_recon import atomic_file
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import TriangleMesh

_VERTEX = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("uncertainty", "<f4")]
)
_FACE = [("count", "u1"), ("vertices", "<i4", 3)]


def write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Write the file atomically. Raises OSError if it cannot be written."""
    atomic_file.replace(path, ply(mesh.vertices_world, mesh.faces, mesh.rgb, mesh.uncertainty), durable=False)


def ply(
    vertices_world: FloatArray, faces: IntArray, rgb: ByteArray, uncertainty: Float32Array, observed: BoolArray | None = None
) -> bytes:
    """Return the content of the file.

    vertices_world (V, 3), faces (F, 3), rgb (V, 3), uncertainty (V,); observed (F,), optional.
    """
    vertices = np.empty(len(vertices_world), dtype=_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = vertices_world[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = rgb[:, channel]
    vertices["uncertainty"] = uncertainty
    has_observed = observed is not None
    records = np.empty(len(faces), dtype=np.dtype(_FACE + ([("observed", "u1")] if has_observed else [])))
    records["count"], records["vertices"] = 3, faces
    if has_observed:
        records["observed"] = observed
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
        *(["property uchar observed"] if has_observed else []),
        "end_header\n",
    ]
    return "\n".join(head).encode() + vertices.tobytes() + records.tobytes()
