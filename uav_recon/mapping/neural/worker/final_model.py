"""Final model of a flight: the mesh, and the errors of its camera."""

from __future__ import annotations

import json
from pathlib import Path

from uav_recon import atomic_file
from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.surface.ply_writer import write_ply
from uav_recon.types.camera_calibration import CALIBRATION_FILE

MESH_FILE = "mesh.ply"


def write_final_model(folder: Path, mapper: NeuralMapper, config: MapperConfig) -> None:
    """Polish the field and write mesh.ply, and calibration.json if enough views show it.

    Raises OSError.
    """
    mapper.polish(config.polish_steps)
    write_ply(folder / MESH_FILE, mapper.mesh(config.mesh_voxel_m))
    if mapper.camera_errors is not None:
        elements = mapper.camera_errors.elements() | (mapper.colour_errors.elements() if mapper.colour_errors else {})
        text = json.dumps({"elements": elements}, indent=1) + "\n"
        atomic_file.replace(folder / CALIBRATION_FILE, text.encode("ascii"), durable=False)
