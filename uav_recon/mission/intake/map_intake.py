"""Map intake: brings depth frames, free cones and corrections into the occupancy map."""

from __future__ import annotations

import numpy as np

from uav_recon.mission.intake.map_correction import MapCorrectionDetector
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import VoxelMap


class MapIntake:
    """Keeps the map of one mission up to date.

    map: the newest snapshot, None before the first depth frame. frame_s: when a frame of this map last came. map_epoch: epoch
    of the map; what was measured in another one does not fit it and is ignored.
    """

    def __init__(
        self, stages: MissionStages, channels: MissionChannels, parameters: MissionParameters, track: FlightTrack
    ) -> None:
        self._stages = stages
        self._channels = channels
        self._parameters = parameters
        self._track = track
        self._correction = MapCorrectionDetector(channels.correction)
        self._frame_sequence = self._cone_sequence = 0
        self.map: VoxelMap | None = None
        self.map_epoch = 0
        self.frame_s = -np.inf
        self._declare_takeoff_free()

    def rebuild_corrected(self) -> bool:
        """Rebuild the map after a correction; return True if there was one.

        Positions where the vehicle flew are free.
        """
        correction = self._correction.detect()
        if correction is None:
            return False
        self.map_epoch = correction.map_epoch
        self._stages.voxels.reset(correction.map_epoch)
        half_m = self._parameters.vehicle_height_m / 2
        for crumb in self._track.breadcrumbs:
            z_m = float(crumb[2])
            self._stages.voxels.declare_free(crumb, self._parameters.clear_radius_m, z_m - half_m, z_m + half_m)
        self._stages.mapper.repose(correction)
        self.map = self._stages.voxels.snapshot()
        return True

    def integrate_frame(self, now_s: float) -> PosedFrame | None:
        """Integrate the newest depth frame; return it, None if no new one is in the map."""
        sequence = self._channels.frames.sequence()
        posed = self._channels.frames.latest() if sequence != self._frame_sequence else None
        if posed is None:
            return None
        self._frame_sequence = sequence
        if posed.map_epoch != self.map_epoch:
            return None
        self.frame_s = now_s
        if posed.unsure:
            return None  # it would draw surfaces where none are
        self._stages.voxels.integrate(posed)
        views = self._stages.recent_views.add(posed)
        if views is not None:
            self._stages.motion.set_recent_views(views)
            self._stages.retreat.set_recent_views(views)
        self._find_surface(posed)
        self.map = self._stages.voxels.snapshot()
        return posed

    def _find_surface(self, posed: PosedFrame) -> None:
        """Bring a frame into the surface by which the camera tells where it is."""
        localizability = self._stages.localizability
        if localizability is not None and localizability.add(posed):
            self._stages.motion.set_surface(localizability.cells)
            self._stages.retreat.set_surface(localizability.cells)

    def integrate_cone(self) -> None:
        """Free what the upward range finder found empty. The first map needs a depth frame."""
        sequence = self._channels.cones.sequence()
        cone = self._channels.cones.latest() if sequence != self._cone_sequence else None
        self._cone_sequence = sequence
        if cone is None or self.map is None or cone.map_epoch != self.map_epoch:
            return
        if self._stages.voxels.integrate_cone(cone):
            self.map = self._stages.voxels.snapshot()

    def _declare_takeoff_free(self) -> None:
        """Declare free the place on the pad, and the column above it that is known to be free."""
        known, half_m = self._parameters, self._parameters.vehicle_height_m / 2
        top_m = known.takeoff_height_m + known.clear_radius_m  # home is clear above too
        self._stages.voxels.declare_free(np.zeros(3), known.takeoff_radius_m, -half_m, top_m)
        if known.takeoff_top_m > top_m:
            self._stages.voxels.declare_free(np.zeros(3), known.takeoff_top_radius_m, top_m, known.takeoff_top_m)
