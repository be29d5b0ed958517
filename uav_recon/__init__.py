"""Map an unknown room autonomously, without GPS, into a watertight, coloured, metric model.

As a library (docs/library.md): ``from uav_recon import Camera, OccupancyMapper, NeuralMapper, ViewPlanner, Pose``. Each
name is loaded at its first use, so that importing the package stays fast.
"""

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uav_recon.app.library import warm_up
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper
    from uav_recon.mapping.occupancy.occupancy_mapper import OccupancyMapper
    from uav_recon.planning.view_planner import ViewPlanner
    from uav_recon.types.camera import Intrinsics
    from uav_recon.types.pose import Pose
    from uav_recon.types.rgbd_camera import Camera
    from uav_recon.types.tasks import NothingLeft, ViewPath

# Set before numpy is loaded: with huge pages the first access to a page of a large map stalls a frame for 6 to 50 ms.
os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Intrinsics",
    "NeuralMapper",
    "NothingLeft",
    "OccupancyMapper",
    "Pose",
    "ViewPath",
    "ViewPlanner",
    "__version__",
    "warm_up",
]

if not TYPE_CHECKING:  # otherwise a type checker would accept any name
    _MODULES = {
        "Camera": "types.rgbd_camera",
        "Intrinsics": "types.camera",
        "NeuralMapper": "mapping.neural.neural_mapper",
        "NothingLeft": "types.tasks",
        "OccupancyMapper": "mapping.occupancy.occupancy_mapper",
        "Pose": "types.pose",
        "ViewPath": "types.tasks",
        "ViewPlanner": "planning.view_planner",
        "warm_up": "app.library",
    }

    def __getattr__(name):
        """Import a public name at its first use."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        return value

    def __dir__():
        """Return the public names and what is loaded already."""
        return sorted({*globals(), *__all__})
