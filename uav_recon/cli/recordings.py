"""`uav-recon replay` and `uav-recon record`: recordings of the world."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.recording_options import FORMAT, FormatDepthUnitOption
from uav_recon.cli.services import CONFIG, ConfigOption

REPLAY_EXAMPLES = (
    "uav-recon replay rgbd_dataset_freiburg1_room --out replay/room      # a TUM RGB-D folder",
    "uav-recon replay 7scenes/chess/seq-01 --mapper none                 # perception and occupancy map only",
    "uav-recon replay room.mcap --depth-unit 0.00025                     # depth of an L515, in quarters of a millimetre",
    "uav-recon replay flight.mcap --colour-topic /camera/color/image     # a ROS 2 bag, or a recording of `uav-recon record`",
)
RECORD_EXAMPLES = (
    "uav-recon record                                     # until Ctrl-C, into recording-DATE.mcap",
    "uav-recon record room.mcap --seconds 120 --max-gb 4  # hold the drone in the hand and walk through the room",
)


def replay(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", readable=False, help="A recording: folder or file.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", readable=False, help="Folder of the results. Default: replay/NAME-DATE.")
    ] = None,
    pose: Annotated[
        str, typer.Option(metavar="recording|slam", help="Poses: of the recording, or the embedded SLAM.")
    ] = "recording",
    mapper: Annotated[str, typer.Option(metavar="neural|none", help="none: no model is learned, much faster.")] = "neural",
    up: Annotated[
        str,
        typer.Option(
            metavar="auto|source|first|floor",
            help="Which way is up: z of the recording's poses, the first image is level, or the normal of floor and tables. "
            "auto: as the format says.",
        ),
    ] = "auto",
    views: Annotated[int, typer.Option(min=4, max=5000, help="Views that the mapper may get.")] = 60,
    depth_range: Annotated[
        tuple[float, float], typer.Option(metavar="MIN MAX", help="Depths outside are ignored, in metres.")
    ] = (0.3, 6.0),
    intrinsics: Annotated[
        str | None, typer.Option(metavar="FX,FY,CX,CY", rich_help_panel=FORMAT, help="For folders that have none, in pixels.")
    ] = None,
    depth_unit: FormatDepthUnitOption = None,
    depth_topic: Annotated[str | None, typer.Option(metavar="TOPIC", rich_help_panel=FORMAT, help="Of a bag: depth.")] = None,
    colour_topic: Annotated[str | None, typer.Option(metavar="TOPIC", rich_help_panel=FORMAT, help="Colour.")] = None,
    pose_topic: Annotated[str | None, typer.Option(metavar="TOPIC", rich_help_panel=FORMAT, help="Poses.")] = None,
    imu_topic: Annotated[str | None, typer.Option(metavar="TOPIC", rich_help_panel=FORMAT, help="Inertial samples.")] = None,
    pose_of: Annotated[
        str,
        typer.Option(
            metavar="camera|body", rich_help_panel=FORMAT,
            help="Whose pose a bag has, where no transform connects it with the camera.",
        ),
    ] = "camera",
) -> None:  # fmt: skip
    """Run perception, maps and planner of a flight over a recording.

    SOURCE is a flight folder, a TUM RGB-D folder, a 7-Scenes folder, a ROS 2 bag (.mcap, .db3), a recording of
    `uav-recon record` or of librealsense (.db3, .bag); the format is detected. It prints which frames were refused and why,
    alarms, and the camera's errors, and writes mesh.ply, report.html, replay.json and trajectory.txt (TUM format). Nothing is
    flown.
    """
    from rich.console import Console

    from uav_recon.app import recording_options
    from uav_recon.app import replay as replaying

    folder = out or Path("replay") / f"{source.absolute().name}-{time.strftime('%Y%m%d-%H%M%S')}"

    def work() -> int:
        topics = recording_options.topics(depth_topic, colour_topic, pose_topic, imu_topic, pose_of)
        read = recording_options.read_options(depth_range, intrinsics, topics, depth_unit)
        options = replaying.ReplayOptions(source, folder, read, pose, mapper, up, views)
        return replaying.replay(options, Console())

    exit_with(work)


def record(
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", readable=False, help="File to write. Default: recording-DATE.mcap.")
    ] = None,
    config: ConfigOption = CONFIG,
    max_gb: Annotated[float, typer.Option(min=0.01, max=10000.0, help="Size at most, in gigabytes.")] = 20.0,
    seconds: Annotated[float | None, typer.Option(min=1.0, max=86400.0, help="Time at most.")] = None,
) -> None:
    """Record what the camera gives: frames, inertial samples and poses.

    The file is an MCAP with ROS 2 messages: Foxglove and the ros2 tools open it, `uav-recon replay` replays it. Ctrl-C ends it.
    After a loss of power it is readable up to the last whole chunk (1 MB). A camera stream may be recorded beside a flight. A
    RealSense has one reader: stop uav-recon-perception first.
    """
    from rich.console import Console

    from uav_recon.app import processes
    from uav_recon.app import record as recording

    def work() -> int:
        stop = processes.Stop()
        limit_s = math.inf if seconds is None else seconds
        options = recording.RecordOptions(config, out or recording.default_name(), max_gb, limit_s)
        return recording.record(options, Console(), lambda: stop.asked)

    exit_with(work)
