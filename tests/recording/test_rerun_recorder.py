"""The recorder writes every channel, reads each value once, and survives faults."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from flight_inputs import START_S, frame, mesh, odometry, progress, surface, vehicle, view_path, voxel_map

from uav_recon.app.flight_channels import FlightChannels, memory_channels
from uav_recon.channels import MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.recording import blueprint as names
from uav_recon.recording.rerun_archetypes import depth_png
from uav_recon.recording.rerun_recorder import Inbox, RerunRecorder
from uav_recon.recording.review import check_recording
from uav_recon.recording.timelapse import load_states
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Intent, Setpoint, Trajectory

FENCE = np.array([[-1.0, -1.0, 0.0], [3.0, 2.0, 2.4]])


def trajectory() -> Trajectory:
    zeros, row = np.zeros((9, 3)), np.zeros(9)
    return Trajectory(START_S, 0.1, zeros, zeros, zeros, row, row, row, np.zeros(0), 0, 5)


def fly(folder: Path, duration_s: float = 6.0, **options: Any) -> tuple[RerunRecorder, FlightChannels]:
    clock, channels = ManualClock(START_S), memory_channels()
    recorder = RerunRecorder(folder, channels, clock, FENCE, **options)
    for k in range(int(duration_s * 10)):
        t_s = k / 10
        clock.advance_to(START_S + t_s)
        channels.odom.publish(odometry(t_s))
        channels.frames.publish(frame(t_s))
        channels.vehicle.publish(vehicle(t_s, Reason(ReasonCode.ARMING_WITHDRAWN) if k == 20 else None))
        channels.intent.publish(Intent(START_S + t_s, Goal.FLY, trajectory()))
        channels.progress.publish(progress(t_s))
        if k % 20 == 0:
            channels.voxels.publish(voxel_map())
            channels.surface.publish(surface())
            channels.plan.publish(view_path())
        recorder.step()
    return recorder, channels


def counts(folder: Path, by_chunk: bool = False) -> dict[str, int]:
    """Return the number of rows, or of chunks, per entity of the temporal data."""
    from rerun.chunk import RrdReader

    found: dict[str, int] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a killed recorder leaves a file without a footer
        for chunk in RrdReader(folder / names.RECORDING).stream().to_chunks():
            entity = str(chunk.entity_path).lstrip("/")
            found[entity] = found.get(entity, 0) + (1 if by_chunk else chunk.num_rows)
    return found


def rows(folder: Path) -> dict[str, int]:
    """Return the number of rows per entity of the temporal data."""
    return counts(folder)


def test_a_flight_is_recorded_completely(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path)
    recorder.close(mesh())
    found = rows(tmp_path)
    for entity in (
        names.FENCE, names.BODY, names.DEPTH, f"{names.DEPTH}/image", names.RGB, f"{names.RGB}/image", names.VOXELS,
        names.SURFACE, names.PLAN, f"{names.PLAN}/views", names.TRAJECTORY, names.MESH, names.EXPLORED, names.PLANNING,
        names.CLEARANCE, f"{names.TRAIL}/0000", f"{names.LOG}/pilot_note", f"{names.LOG}/mission",
    ):  # fmt: skip
        assert found.get(entity, 0) > 0, entity
    assert found[names.SPEED] == 60
    assert (found[names.PLACE_PREDICTED], found[names.PLACE_MEASURED]) == (60, 50)  # the measured one is known from 1 s on


def test_images_are_recorded_at_a_reduced_rate_and_a_trajectory_once(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path, duration_s=6.0)
    recorder.close()
    found = rows(tmp_path)
    assert found[f"{names.DEPTH}/image"] == 12
    assert found[names.VOXELS] == found[names.CEILING] == 3
    assert found[names.TRAJECTORY] == 1
    assert found[f"{names.LOG}/mission"] == 1  # logged only when it changes
    assert recorder.skipped()["frames"] == 44  # 56 until the last image, 12 images
    assert recorder.skipped()["odom"] == 0


def test_the_trail_is_cut_into_strips(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path, duration_s=24.0)
    recorder.close()
    found = rows(tmp_path)
    assert f"{names.TRAIL}/0001" in found
    assert max(count for entity, count in found.items() if entity.startswith(names.TRAIL)) <= 101


def test_a_killed_recorder_leaves_a_readable_file(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path)  # never closed, flushed every two seconds
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / names.RECORDING).write_bytes((tmp_path / names.RECORDING).read_bytes())
    assert rows(copy)[names.SPEED] >= 40
    summary = check_recording(copy)
    assert "/world/body" in summary.entities
    recorder.close()


@pytest.mark.nightly
def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    """Covers half an hour at two steps a second.

    A list of chunks for a footer would take 12 MB in that time.
    """
    clock, channels = ManualClock(START_S), memory_channels()
    recorder = RerunRecorder(tmp_path, channels, clock, FENCE)
    memory_mb = []
    for k in range(4800):
        t_s = k / 2
        clock.advance_to(START_S + t_s)
        channels.odom.publish(odometry(0.0))
        channels.vehicle.publish(vehicle(0.0, Reason(ReasonCode.VIEWS_SPENT, (k,))))
        channels.progress.publish(progress(0.0))
        recorder.step()
        memory_mb.append(
            int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
        )
    recorder.close()
    assert memory_mb[-1] - memory_mb[1200] < 3.0


def test_a_recording_is_written_in_few_chunks(tmp_path: Path) -> None:
    """Values that arrive ten times a second are written as about one chunk per second."""
    recorder, _ = fly(tmp_path, duration_s=20.0)
    recorder.close()
    assert rows(tmp_path)[names.SPEED] == 200
    for entity in (names.SPEED, names.BODY, names.CLEARANCE, names.DEPTH, f"{names.DEPTH}/image", names.EXPLORED):
        assert counts(tmp_path, by_chunk=True)[entity] <= 24, entity


def test_the_mesh_file_is_drawn_and_a_broken_one_is_only_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    import trimesh

    model = mesh()
    trimesh.Trimesh(model.vertices_world, model.faces, vertex_colors=model.rgb).export(tmp_path / "mesh.ply")
    recorder, _ = fly(tmp_path, duration_s=0.5)
    recorder.close()
    assert rows(tmp_path)[names.MESH] == 1
    (tmp_path / "mesh.ply").write_bytes(b"no mesh at all")
    recorder, _ = fly(tmp_path, duration_s=0.5)
    recorder.close()
    assert names.MESH not in rows(tmp_path)
    assert "cannot be read as a mesh" in caplog.text


def test_without_a_viewer_the_flight_is_still_recorded(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path, duration_s=1.0, live=True, find_viewer=lambda: None)
    recorder.close()
    assert rows(tmp_path)[names.SPEED] == 10


def test_channels_without_values_are_accepted(tmp_path: Path) -> None:
    clock = ManualClock(5.0)
    recorder = RerunRecorder(tmp_path, memory_channels(), clock, FENCE)
    clock.advance_to(6.0)
    recorder.step()
    recorder.close()
    assert check_recording(tmp_path).chunks > 0


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"flight\.rrd"):
        RerunRecorder(tmp_path / "missing", memory_channels(), ManualClock(), FENCE)


def test_an_inbox_returns_a_value_once_and_counts_skipped_ones() -> None:
    wire = MemoryChannel(Setpoint)
    inbox: Inbox[Setpoint] = Inbox(wire)
    assert inbox.new() is None
    for x in (1.0, 2.0, 3.0):
        wire.publish(Setpoint.hold(np.array([x, 0, 0]), 0.0))
    found = inbox.new()
    assert found is not None and found.position_m[0] == 3.0
    assert inbox.skipped == 2
    assert inbox.new() is None


def test_depth_is_stored_in_whole_millimetres() -> None:
    taken = frame(0.0).frame
    image = cv2.imdecode(np.frombuffer(depth_png(taken), np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None and image.dtype == np.uint16
    assert (image[:, :5] == 0).all() and (image[:, 5:] == 2000).all()


def test_the_growing_surface_is_saved_periodically(tmp_path: Path) -> None:
    recorder, channels = fly(tmp_path, duration_s=6.0)
    channels.surface.publish(surface())  # just before the end
    recorder.close()
    assert [round(state.stamp_s - START_S, 3) for state in load_states(tmp_path)] == [0.0, 2.0, 5.9]
