"""Stub for the computation of visible ground truth, which takes a quarter of a minute."""

from __future__ import annotations

import types

import numpy as np

from sitl.apps.sim_options import SimOptions
from sitl.camera.d435i import MOUNT_M, stream_header
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.scene.scene import Scene


def quick_cut(options: SimOptions, scene: Scene) -> types.SimpleNamespace:
    """Return three positions above the start instead of the six hundred of the real computation."""
    positions = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.1], [0.0, 0.3, 1.2]], np.float32)
    views = [world_from_body(positions[0], yaw) @ body_from_camera(MOUNT_M, 0.26) for yaw in (0.0, 1.5)]
    return types.SimpleNamespace(positions=positions, views=np.array(views), view_spec=stream_header("d435i").rgb)
