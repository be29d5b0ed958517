"""Detection of the format of a recording, from its content."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from uav_recon.sensors.recordings.bag_messages import BagTopics
from uav_recon.sensors.recordings.bag_storage import BagStorage, bag_file
from uav_recon.sensors.recordings.checked_recording import CheckedRecording, faults_of
from uav_recon.sensors.recordings.flight_folder import FlightFolder, is_flight_folder
from uav_recon.sensors.recordings.realsense_file import RealSenseFile, is_realsense_file
from uav_recon.sensors.recordings.recording import Pinhole, Recording, RecordingError
from uav_recon.sensors.recordings.ros_bag import RosBag
from uav_recon.sensors.recordings.seven_scenes_folder import SevenScenesFolder, is_seven_scenes_folder
from uav_recon.sensors.recordings.tum_folder import TumFolder, is_tum_folder

WANTED = (
    "want a flight folder (keyframes/poses.json), a TUM RGB-D folder (rgb.txt, depth.txt), a 7-Scenes folder "
    "(frame-NNNNNN.depth.png), a ROS 2 bag (.mcap, .db3, .zstd or a folder with one), or a librealsense recording (.db3, .bag)"
)


@dataclass(frozen=True)
class ReadOptions:
    """Options of the readers.

    Depths outside the range are no returns; k: fx, fy, cx, cy for formats without intrinsics. metres_per_unit: of depth images;
    None: as the format has it.
    """

    depth_min_m: float = 0.3
    depth_max_m: float = 6.0
    k: Pinhole | None = None
    topics: BagTopics = field(default_factory=BagTopics)
    metres_per_unit: float | None = None


def open_recording(path: Path, options: ReadOptions) -> CheckedRecording:
    """Open a recording.

    Raises RecordingError (one line) that says what was found and what is wanted. The calls of the recording raise no other.
    """
    with faults_of(path):
        return CheckedRecording(path, _opened(path, options), (options.depth_min_m, options.depth_max_m))


def _opened(path: Path, options: ReadOptions) -> Recording:
    unit = options.metres_per_unit
    if not path.exists():
        raise RecordingError(f"{path}: does not exist; {WANTED}")
    if path.is_dir() and is_flight_folder(path):
        return FlightFolder(path, unit)
    if path.is_dir() and is_tum_folder(path):
        return TumFolder(path, options.k, unit)
    if path.is_dir() and is_seven_scenes_folder(path):
        return SevenScenesFolder(path, options.k, unit)
    file = bag_file(path)
    if file is None:
        raise RecordingError(f"{path}: {_found(path)}; {WANTED}")
    storage = BagStorage(file)
    return RealSenseFile(storage, unit) if is_realsense_file(storage) else RosBag(storage, unit, options.topics)


def _found(path: Path) -> str:
    if path.is_dir():
        names = sorted(entry.name for entry in path.iterdir())
        return f"a folder with {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}" if names else "an empty folder"
    with path.open("rb") as file:
        head = file.read(13)
    return f"a file that begins with {head[:8]!r}"
