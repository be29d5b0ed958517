"""Learns the field from keyframes: replay, one step, surface, mesh. One thread, repeatable for a seed."""

from __future__ import annotations

import numpy as np

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.alignment import Alignment
from uav_recon.mapping.neural.field import Field
from uav_recon.mapping.neural.grid import POINTS
from uav_recon.mapping.neural.intake import acceptable, padded
from uav_recon.mapping.neural.livesurface import LiveSurface
from uav_recon.mapping.neural.losses import TETRAHEDRON, fit_colour, fit_distance, fit_shape
from uav_recon.mapping.neural.optimiser import Optimiser
from uav_recon.mapping.neural.rays import pixel_stride, ray_records
from uav_recon.mapping.neural.render import render_rays
from uav_recon.mapping.neural.replay import Replay
from uav_recon.mapping.neural.samples import draw, make_batch
from uav_recon.mapping.neural.surface import Evidence, WholeSurface, surface_elements, triangle_mesh, whole_surface
from uav_recon.mapping.neural.testimony import Testimony
from uav_recon.mapping.neural.uncertainty import (
    ColourError,
    DepthInformation,
    MeasuredAgreement,
    NetworkColourSigma,
    ProductUncertainty,
    SurfaceUncertainty,
)
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.maps import SurfaceElements, TriangleMesh
from uav_recon.types.pose import Pose

ALIGN_AT = (0.0, 0.2, 0.4)  # shares of the polish at which views are aligned
DEFAULT_UNCERTAINTY = "agreement"  # what ranked true errors best; see `uav-recon bench uncertainty`
FINAL_RATE = 0.1  # the polish ends at this share of the learning rate


class Trainer:
    """The mapper without its process. box_min_m, box_max_m (3,): the room's box in world.

    depth_noise_px: disparity noise of the depth image as delivered; baseline_m: stereo baseline. uncertainties: all measures
    by name; uncertainty: the one that elements carry, which may be set to any of them.
    """

    def __init__(
        self, config: MapperConfig, box_min_m: FloatArray, box_max_m: FloatArray, depth_noise_px: float, baseline_m: float
    ) -> None:
        self._config, self._noise_px, self._baseline_m = config, depth_noise_px, baseline_m
        low, high = padded(box_min_m, box_max_m)
        self._low, self._high = low.astype(np.float32), high.astype(np.float32)
        self._random = np.random.default_rng(config.seed)
        self._stream = np.array([config.seed], dtype=np.uint64)
        self.field = Field(low, high, config.seed)
        self._optimiser = Optimiser(self.field)
        self._replay = Replay()
        self._batch = make_batch()
        self._corners = np.zeros((POINTS, 3), dtype=np.float32)
        self._evidence = Evidence(low, high)
        self._live = LiveSurface(self._evidence, config.surface_voxel_m)
        self._images = Testimony()
        self._alignment = Alignment()
        self.align_views = True
        self._information, self._colour_error = DepthInformation(low, high), ColourError(low, high)
        self._agreement = MeasuredAgreement(low, high)
        self.uncertainties: dict[str, SurfaceUncertainty] = {
            "paper": NetworkColourSigma(self.field.colour_sigma),
            "colour": self._colour_error,
            "information": self._information,
            "product": ProductUncertainty(self._colour_error, self._information),
            "agreement": self._agreement,
        }
        self.uncertainty = self.uncertainties[DEFAULT_UNCERTAINTY]
        self.refused, self.steps, self._map_epoch = 0, 0, 0

    @property
    def views(self) -> int:
        """Keyframes taken so far."""
        return self._replay.count

    def add(self, keyframe: PosedFrame) -> bool:
        """Take a keyframe. False (counted in ``refused``) if it is not acceptable (see intake)."""
        frame = keyframe.frame
        if not acceptable(keyframe, self._low, self._high):
            self.refused += 1
            return False
        lens = frame.depth_intrinsics
        sigma = self._noise_px / (lens.fx * self._baseline_m)
        most = self._replay.rays_per_view()
        records = ray_records(frame, sigma, most, self._random)
        rotation, position = keyframe.world_from_depth.rotation(), keyframe.world_from_depth.translation_m
        view = self._replay.rays(records, rotation, position, sigma)
        self._replay.add(records, rotation, position, sigma)
        self._alignment.add(rotation, position)
        # in rows of the picture, so that neighbours in space lie side by side in memory
        beside = np.argsort((records[:, 1].astype(np.int64) << 32) + records[:, 0], kind="stable")
        for points in view.points:
            self.field.cover(points[beside])
        self._optimiser.follow_growth()
        self._information.add(view.points[0], view.cosine, view.sigma_m)
        self._agreement.add(view.points[0], view.normal)
        footprint_m = np.sqrt(view.sigma_m / sigma) * (pixel_stride(lens, most) / lens.fx)
        self._evidence.add(position, view.points[0], view.normal, view.sigma_m, footprint_m.astype(np.float32))
        self._live.touch(view.points[0])
        self._images.add(frame.depth_m, np.array([lens.fx, lens.fy, lens.cx, lens.cy]), rotation, position, sigma)
        self._map_epoch = keyframe.map_epoch
        return True

    def train(self, steps: int, rate: float = 1.0) -> float:
        """Run steps; returns the last loss (0 before the first view). rate: share of the full learning rate."""
        loss = 0.0
        for _ in range(steps if self._replay.count else 0):
            loss = self._step(rate)
        return loss

    def polish(self, steps: int) -> None:
        """Align the views with each other and train on, with a learning rate that falls to FINAL_RATE.

        What remains of the noise averages out; the alignment takes away most of what poses did to it.
        """
        aligned_at = {int(steps * share) for share in ALIGN_AT}
        for n in range(steps if self.views else 0):
            if self.align_views and n in aligned_at:
                self._alignment.refine(self.field, self._replay)
            self.train(1, FINAL_RATE ** ((n + 1) / steps))

    @property
    def element_spacing_m(self) -> float:
        """Distance between neighbouring elements of surface()."""
        return self._config.surface_voxel_m

    def surface(self) -> SurfaceElements:
        """Elements of the surface; none before the first view. New where new views looked, elsewhere a little older."""
        self._live.refresh(self.field, self.uncertainty)
        return self._live.elements(self.views, self._map_epoch)

    def whole_room(self) -> SurfaceElements:
        """Elements of the whole surface as it is now."""
        voxel_m = self._config.surface_voxel_m
        return surface_elements(self.field, self._evidence, self.uncertainty, voxel_m, self.views, self._map_epoch)

    def whole_surface(self, voxel_m: float) -> WholeSurface:
        """Every place where the field changes its sign, also where nobody looked: to ask what an uncertainty says of it."""
        return whole_surface(self.field, self._evidence, voxel_m)

    def mesh(self, voxel_m: float) -> TriangleMesh:
        """Triangles of the surface as it is now."""
        return triangle_mesh(self.field, self._evidence, self.uncertainty, voxel_m, self._images)

    def look(self, origin: Float32Array, direction: Float32Array) -> Float32Array:
        """Colour (N, 3) in 0..1 seen along rays from origin (N, 3) in unit direction (N, 3), drawn through the field."""
        return render_rays(self.field, self._evidence.holding(), origin, direction)[0]

    def positions(self) -> FloatArray:
        """Where the views' depth imagers are now held to have been, world (V, 3)."""
        return self._replay.views.position[: self.views].astype(np.float64)

    def corrections(self) -> FloatArray:
        """What alignment did to the given poses (V, 6): translation and rotation vector about the camera, world."""
        return self._alignment.correction.copy()

    def warm_up(self) -> None:
        """Compile every kernel, on a small trainer of its own."""
        small = Trainer(self._config, np.zeros(3), np.ones(3), self._noise_px, self._baseline_m)
        small.add(_wall())
        small.train(1)
        small.surface()
        small.mesh(0.05)

    def _step(self, rate: float) -> float:
        f, o, b = self.field, self._optimiser, self._batch
        coloured = int(draw(self._stream, self._replay.views, self._replay.count, self._low, self._high, b))
        shared = (f.grid, f.network, o.network_gradient, o.gradient, f.scratch)
        loss = fit_distance(*shared, b.points, b.target_m, b.weight, b.at_least)
        loss += fit_shape(*shared, TETRAHEDRON, self._corners, b.surface, b.normal, b.eikonal_weight, b.normal_weight)
        points, error = b.coloured[:coloured], b.colour_error[:coloured]
        loss += fit_colour(*shared, points, b.rgb[:coloured], b.colour_weight[:coloured], error)
        o.step(rate)
        self._colour_error.add(points, error)
        self.steps += 1
        return float(loss)


def _wall() -> PosedFrame:
    lens = Intrinsics.from_fov(64, 48, 1.2, 0.9)
    depth = np.full((48, 64), 0.5, dtype=np.float32)
    frame = Frame(0.0, 0, depth, lens, np.full((48, 64, 3), 128, dtype=np.uint8), lens, Pose.identity())
    return PosedFrame(frame, Pose.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]), np.array([0.2, 0.5, 0.5])))
