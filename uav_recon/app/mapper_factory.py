"""Factory of the neural mapper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, UserError

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper


def make_neural_mapper(config: Config) -> NeuralMapper:
    """Return the neural field of the mapper. Raises UserError if its prior model cannot be used."""
    from uav_recon.mapping.neural.keyframes.normal_prior import PriorError
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper

    safety, camera = config.safety, config.camera
    low, high = np.array(safety.fence_min_m), np.array(safety.fence_max_m)
    try:
        return NeuralMapper(
            config.mapper, low, high, camera.depth_noise_px, camera.baseline_m, own_poses=config.localization.source == "slam"
        )
    except PriorError as error:
        raise UserError(str(error), EXIT_CONFIG) from None
