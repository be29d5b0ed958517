"""Publish frames, inertial samples and poses as a camera stream.

This file is the interface through which uav_recon reads any camera. Set `camera.source = "stream"` in the configuration,
and write to `camera.stream` below `runtime.folder`. This example publishes a synthetic wall that comes nearer, then reads
the newest frame back.
"""

import sys
import time
from pathlib import Path

import numpy as np

from uav_recon.sensors.stream_format import CameraSpec, StreamHeader, StreamReader, StreamWriter

WIDTH = 424
HEIGHT = 240
RATE_HZ = 30.0
DURATION_S = 2.0


def main(out: str = "camera.stream") -> None:
    """Publish for DURATION_S."""
    lens = CameraSpec(WIDTH, HEIGHT, fx=223.4, fy=216.5, cx=(WIDTH - 1) / 2, cy=(HEIGHT - 1) / 2)
    writer = StreamWriter(Path(out), StreamHeader(depth=lens, rgb=lens, rgb_from_depth=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    rgb = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    rgb[..., 0], rgb[..., 1] = np.arange(WIDTH) * 255 // WIDTH, (np.arange(HEIGHT) * 255 // HEIGHT)[:, None]
    start_s = time.monotonic()  # all stamps are CLOCK_MONOTONIC, at capture
    for n in range(round(DURATION_S * RATE_HZ)):
        stamp_s = start_s + n / RATE_HZ
        time.sleep(max(0.0, stamp_s - time.monotonic()))
        moved_m = 0.3 * (stamp_s - start_s)
        depth_mm = np.full((HEIGHT, WIDTH), 3000 - round(1000 * moved_m), dtype=np.uint16)  # 0 = no return
        writer.write_frame(stamp_s, depth_mm, rgb)
        writer.write_imu(stamp_s, np.zeros(3), np.array([0.0, 0.0, 9.81]))  # body axes: x forward, y left, z up
        position_m, quat_wxyz = np.array([moved_m, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])  # odom_from_body
        variance = np.array([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])  # m2 of the position, rad2 of the rotation
        writer.write_pose(stamp_s, position_m, quat_wxyz, variance, quality=100)

    newest = StreamReader(Path(out)).frame()
    if newest is not None:
        print(f"wrote {newest.sequence} frames to {out}; the newest shows a wall at {np.median(newest.depth_mm) / 1000:.2f} m")


if __name__ == "__main__":
    main(*sys.argv[1:])
