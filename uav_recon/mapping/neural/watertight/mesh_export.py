"""Export of a closed mesh: PLY with vertex colours, and GLB with a texture.

Both mark observed surface and surface that only closes the room: the PLY by the face property ``observed``, the GLB by a
separate primitive and material ``unseen``. The nodes of the GLB rotate the world frame (z up) to the axes of glTF (y up).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from uav_recon import atomic_file
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.surface.ply_writer import ply
from uav_recon.mapping.neural.watertight.texture_atlas import unwrap
from uav_recon.mapping.neural.watertight.texture_baking import baked_texture
from uav_recon.mapping.neural.watertight.watertight_mesh import ClosedMesh
from uav_recon.types.frames import FloatArray, IntArray

OBSERVED = "observed"
UNSEEN = "unseen"
UNSEEN_RGBA = (0.45, 0.45, 0.47, 1.0)
GLTF_FROM_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def write_closed_ply(path: Path, mesh: ClosedMesh) -> None:
    """Write the PLY file atomically. Raises OSError if it cannot be written."""
    atomic_file.replace(path, ply(mesh.vertices_world, mesh.faces, mesh.rgb, mesh.uncertainty, mesh.observed), durable=False)


def write_textured_glb(path: Path, mesh: ClosedMesh, field: SdfField, texel_m: float) -> None:
    """Write the GLB file atomically, with texel colours queried from the field.

    Raises OSError if it cannot be written.
    """
    import trimesh
    from PIL import Image

    scene = trimesh.Scene()
    seen = mesh.faces[mesh.observed]
    if len(seen):
        atlas = unwrap(mesh.vertices_world, seen, mesh.normals, texel_m)
        material = trimesh.visual.material.PBRMaterial(
            name=OBSERVED,
            baseColorTexture=Image.fromarray(baked_texture(atlas, field)),
            metallicFactor=0.0,
            roughnessFactor=1.0,
        )
        visual = trimesh.visual.TextureVisuals(uv=atlas.uv, material=material)
        _add(scene, OBSERVED, mesh.vertices_world[atlas.source], atlas.faces, visual)
    rest = mesh.faces[~mesh.observed]
    if len(rest):
        used, named = np.unique(rest, return_inverse=True)
        grey = trimesh.visual.material.PBRMaterial(
            name=UNSEEN, baseColorFactor=UNSEEN_RGBA, metallicFactor=0.0, roughnessFactor=1.0
        )
        visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(used), 2)), material=grey)
        _add(scene, UNSEEN, mesh.vertices_world[used], named.reshape(-1, 3), visual)
    atomic_file.replace(path, scene.export(file_type="glb"), durable=False)


def _add(scene: Any, name: str, vertices: FloatArray, faces: IntArray, visual: Any) -> None:
    import trimesh

    body = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    scene.add_geometry(body, geom_name=name, node_name=name, transform=GLTF_FROM_WORLD)
