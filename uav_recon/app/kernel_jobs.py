"""The kernels of the product, as jobs for kernel_cache.

A job calls what a process calls before it is ready. A process is split into jobs of a fraction of a minute. Which kernels
are compiled depends on the planner's variant and on the config's options, not on its sizes.
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

from uav_recon.app import config_file, mapper_factory, mission_factory
from uav_recon.app.kernel_cache import KernelJob
from uav_recon.config import VariantName

HERE = __name__
MAPPER = "mapper"
PERCEPTION = KernelJob("perception", f"{HERE}:perception", 21)
SLAM = KernelJob("slam", f"{HERE}:slam", 15)


def perception_jobs() -> list[KernelJob]:
    """Return the jobs of the perception process.

    The embedded SLAM gives the poses, or checks them.
    """
    return [PERCEPTION, SLAM]


def mission_jobs(variant: VariantName) -> list[KernelJob]:
    """Return the jobs of the mission process and its mapper.

    Their order keeps two cores busy to the end.
    """
    return [
        KernelJob("frontiers", f"{HERE}:frontiers", 62),
        KernelJob("paths", f"{HERE}:paths", 55),
        KernelJob(MAPPER, f"{HERE}:mapper", 73),
        KernelJob(f"planner {variant}", f"{HERE}:planner", 41, ("frontiers", "paths"), variant),
        KernelJob("map", f"{HERE}:occupancy_map", 38),
        KernelJob("motion", f"{HERE}:motion", 25),
    ]


def perception(_config_path: Path, _: str) -> None:
    """Compile the kernels of the perception process."""
    from uav_recon.localization.perception import perception as stage

    stage.warm_up()


def slam(_config_path: Path, _: str) -> None:
    """Compile the kernels of the embedded SLAM."""
    from uav_recon.localization.slam import slam_tracker

    slam_tracker.warm_up()


def frontiers(_config_path: Path, _: str) -> None:
    """Compile the kernels of the frontiers."""
    from uav_recon.planning import view_planner

    view_planner.warm_up_frontiers()


def paths(_config_path: Path, _: str) -> None:
    """Compile the kernels of paths, tours and gains."""
    from uav_recon.planning import view_planner

    view_planner.warm_up_paths()


def planner(_: Path, variant: str) -> None:
    """Compile the kernels of the planner's variant.

    Those of frontiers and paths come from the cache.
    """
    from uav_recon.planning import view_planner

    view_planner.warm_up(cast(VariantName, variant))


def occupancy_map(config_path: Path, _: str) -> None:
    """Compile the kernels of the occupancy map and the keyframe selection."""
    mission_factory.warm_up_map(config_file.load_config(config_path))


def motion(config_path: Path, _: str) -> None:
    """Compile the kernels of motion planning."""
    mission_factory.warm_up_motion(config_file.load_config(config_path))


def mapper(config_path: Path, _: str) -> None:
    """Compile the kernels of the neural mapper."""
    config = config_file.load_config(config_path)
    mapper_config = config.mapper.model_copy(update={"prior_model": None})  # it needs no compilation
    mapper_factory.make_neural_mapper(config.model_copy(update={"mapper": mapper_config})).warm_up()
