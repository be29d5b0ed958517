"""Size of a model against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.apps.model_scale import at_true_size
from sitl.scene.mesh_sampling import dense_points
from sitl.scene.scene import load_scene


@pytest.mark.parametrize("size", [0.985, 1.0, 1.012])
def test_a_model_of_another_size_is_brought_to_the_true_one(size: float) -> None:
    scene = load_scene("small:3", fine=False)
    true = dense_points(scene.vertices.copy(), scene.faces.copy(), 0.04).astype(np.float64)
    turn = Rotation.from_rotvec([0.002, -0.001, 0.004]).as_matrix()
    model = size * true @ turn.T + np.array([0.01, -0.02, 0.01])
    found, larger = at_true_size(model, scene)
    assert larger == pytest.approx(size, abs=0.001)
    assert np.linalg.norm(found - true, axis=1).max() < 0.01
