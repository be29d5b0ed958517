"""The way home: the shortest known-free one, or back along the breadcrumbs."""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_recon.mission.account import Account
from uav_recon.mission.decider import Decider, Decision
from uav_recon.mission.helm import Helm
from uav_recon.protocols import Pending
from uav_recon.types.maps import VoxelMap
from uav_recon.types.tasks import PlanRequest, Viewpoint
from uav_recon.types.trajectory import Trajectory
from uav_recon.types.vehicle import VehicleState


class Homeward:
    """Brings the vehicle over the pad, once. no_way: what is known leads nowhere; lost: the breadcrumbs do not either."""

    def __init__(self, helm: Helm, decider: Decider, account: Account, hover_height_m: float) -> None:
        self._helm, self._decider, self._account, self._hover_height_m = helm, decider, account, hover_height_m
        self._decision: Pending[Decision] | None = None
        self.under_way = self.no_way = False
        self.lost = ""

    def interrupt(self) -> None:
        """Forget what is being thought about: the phase has changed."""
        self._decision = None

    def begin_again(self) -> None:
        """The map is a new one: the way home is looked for anew."""
        self._decision, self.under_way, self.no_way = None, False, False

    def step(self, now_s: float, vehicle: VehicleState, voxels: VoxelMap, along_breadcrumbs: bool) -> None:
        """From rest: think, then fly."""
        course = self._helm.course
        if self.under_way or not course.at_rest(now_s):
            return
        if self._decision is None:
            rest = course.rest(vehicle)
            home = Viewpoint(np.array([0.0, 0.0, self._hover_height_m]), rest.yaw_rad, rest.camera_pitch_down_rad)
            request, identifier = PlanRequest(voxels, None, rest.position_m, rest.yaw_rad, 0), course.next_identifier()
            if along_breadcrumbs:
                self._decision = self._decider.way_back(request, rest, course.way_back(home.position_world), home, identifier)
            else:
                self._decision = self._decider.way_home(request, rest, home, identifier)
        if not self._decision.done():
            return
        decision, self._decision = self._decision.result(), None
        if isinstance(decision.motion, Trajectory):
            self.under_way = True
            self._helm.fly(dataclasses.replace(decision.motion, views_s=np.zeros(0)), now_s)  # home is no view
            return
        self._account.refusal(now_s, decision.motion)
        if along_breadcrumbs:
            self.lost = f"no way back: {decision.motion}"
        else:
            self.no_way = True
