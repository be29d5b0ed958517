"""Reader of the mesh of a flight: mesh.ply, with colour and uncertainty per vertex."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from uav_recon.types.maps import TriangleMesh

MESH = "mesh.ply"
_LOG = logging.getLogger(__name__)


def load_mesh(folder: Path) -> TriangleMesh | None:
    """Read ``folder``/mesh.ply; None if it is missing or cannot be read (which is logged).

    A missing uncertainty is read as 0. Faces marked as not observed, which close the room over space without observation,
    are left out.
    """
    path = folder / MESH
    if not path.exists():
        return None
    import trimesh

    try:
        loaded = trimesh.load(path, process=False, force="mesh")
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces, dtype=np.int64)
        rgb = np.asarray(loaded.visual.vertex_colors, dtype=np.uint8)[:, :3]
        record = loaded.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
        named = record is not None and "uncertainty" in (record.dtype.names or ())
        uncertainty = (
            np.asarray(record["uncertainty"], dtype=np.float32).ravel() if named else np.zeros(len(vertices), np.float32)
        )
        raw_faces = loaded.metadata.get("_ply_raw", {}).get("face", {}).get("data")
        if raw_faces is not None and "observed" in (raw_faces.dtype.names or ()):
            faces = faces[np.asarray(raw_faces["observed"]).ravel() != 0]
        return TriangleMesh(vertices, faces, rgb, uncertainty)
    except (ValueError, KeyError, IndexError, AttributeError, TypeError) as error:
        _LOG.warning("%s cannot be read as a mesh: %s", path, error)
        return None
