"""Read the channels of a flight: files in its runtime folder, readable for its group.

The second argument is this folder, for example /run/uav_recon; without it this example publishes its own values.
"""

import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from uav_recon import Pose
from uav_recon.app.flight_channels import PERCEPTION_WRITES, file_channels, read_only_channels
from uav_recon.errors import UserError
from uav_recon.types.pose import StampedPose

DURATION_S = 2.0


def publish(folder: Path) -> None:
    """Publish odometry at 30 Hz: half a turn per second on a circle of 1 m."""
    odom, start_s = file_channels(folder, PERCEPTION_WRITES).odom, time.monotonic()
    while (elapsed_s := time.monotonic() - start_s) < DURATION_S:
        angle_rad = np.pi * elapsed_s
        position_m = np.array([np.cos(angle_rad), np.sin(angle_rad), 1.2])
        velocity_mps = np.pi * np.array([-np.sin(angle_rad), np.cos(angle_rad), 0.0])
        odom.publish(StampedPose(time.monotonic(), Pose.from_yaw(angle_rad + np.pi / 2, position_m), velocity_mps))
        time.sleep(1.0 / 30.0)


def read(folder: Path, out: str) -> None:
    """Poll the channels at 100 Hz for DURATION_S."""
    channels, read, rows = read_only_channels(folder), 0, []
    end_s = time.monotonic() + DURATION_S
    while time.monotonic() < end_s:
        newest = channels.odom.latest()  # never blocks; a reader that is slow misses values
        if newest is not None and channels.odom.sequence() != read:
            read = channels.odom.sequence()
            rows.append([newest.stamp_s, *newest.odom_from_body.translation_m, newest.odom_from_body.yaw_rad(), newest.quality])
        time.sleep(0.01)
    np.savetxt(out, np.reshape(rows, (-1, 6)), delimiter=",", header="stamp_s,x_m,y_m,z_m,yaw_rad,quality", comments="")
    print(f"wrote {out}: {len(rows)} of {read} odometry values; map {'present' if channels.voxels.latest() else 'absent'}")


def main(out: str = "odom.csv", folder: str = "") -> None:
    """Read a flight's channels, or those that this example publishes."""
    with tempfile.TemporaryDirectory() as temporary:
        if not folder:
            threading.Thread(target=publish, args=(Path(temporary),), daemon=True).start()
        read(Path(folder or temporary), out)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except UserError as error:  # this user may not read, or the flight is of another build
        sys.exit(str(error))
