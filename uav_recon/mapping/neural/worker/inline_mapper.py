"""The mapper for lockstep: runs in the calling process."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason, counts_as_text
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker.final_model import write_final_model
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.pose import MapCorrection


class InlineMapper:
    """Mapper whose add() trains immediately and whose surface() extracts on request."""

    def __init__(self, trainer: NeuralMapper, config: MapperConfig, keyframes: KeyframeFolder | None = None) -> None:
        self._trainer = trainer
        self._config = config
        self._keyframes = keyframes
        self._surface: SurfaceElements | None = None
        self._stale = False
        self._numbers: dict[float, int] = {}  # numbers of the views taken, by stamp

    def add(self, keyframe: PosedFrame) -> bool:
        """Train on a view; blocks for steps_per_view steps.

        Returns False if the view is rejected. Raises OSError if the keyframe cannot be saved.
        """
        number = self._trainer.views
        if not self._trainer.add(keyframe):
            return False
        self._numbers[keyframe.frame.stamp_s] = number
        if self._keyframes is not None:
            self._keyframes.save(keyframe)
        self._trainer.train(self._config.steps_per_view)
        self._stale = True
        return True

    def repose(self, correction: MapCorrection) -> None:
        """Start a new map in a new map epoch; blocks until all views are learned again.

        Views without a pose in the correction are dropped and counted. Raises OSError if the poses cannot be saved.
        """
        if self._keyframes is not None:
            self._keyframes.repose(correction)
        placed = {self._numbers[stamp_s]: pose for stamp_s, pose in correction.poses() if stamp_s in self._numbers}
        self._trainer.repose(placed, correction.map_epoch)
        self._trainer.learn_waiting(self._trainer.waiting)
        self._stale = True

    def refusals(self) -> Counter[RejectReason]:
        """Return the number of rejected views by reason."""
        return self._trainer.refusals.counts.copy()

    def refused(self) -> dict[str, int]:
        """Return the number of rejected views by reason, as text."""
        return counts_as_text(self.refusals())

    def surface(self) -> SurfaceElements | None:
        """Return the surface after the last view."""
        if self._stale:
            self._surface = self._trainer.surface()
            self._stale = False
        return self._surface

    def alive(self) -> bool:
        """Return True: there is no child process to lose."""
        return True

    def ready(self) -> bool:
        """Return True; call NeuralMapper.warm_up() before the flight."""
        return True

    def finish(self, folder: Path) -> None:
        """Polish the field and write the model."""
        write_final_model(folder, self._trainer, self._config)
