"""Fly one mission for each scene and seed.

`python -m results.mission_seeds --scenes built-in,FOLDER --seeds 1,2,3 --json FILE [--keep FOLDER]`

A seed draws the errors of the camera, the noise and the poses. The JSON file holds each flight, and of each figure the median
and the worst over all flights. Flights that the file already contains, of the same commit, are not repeated.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from results.claims import ROOT
from sitl.apps.sweep_options import BUILT_IN
from sitl.camera.camera_errors import CameraErrors
from uav_recon.measurement import host_info, result_file

Flight = dict[str, Any]
AXES = "xyz"
CALIBRATION_SIGMAS = 2.0  # an estimate within this number of its deviations is an honest one
# which of several is the worst
WORST: Mapping[str, Callable[..., float]] = {
    "accuracy_cm": max,
    "completion_cm": max,
    "recall_5cm": min,
    "psnr_db": min,
    "ate_cm": max,
    "shape_accuracy_cm": max,
    "explored": min,
    "flight_time_s": max,
    "min_clearance_m": min,
    "contacts": max,
    "scale_off": max,
    "mount_off_deg": max,
    "delay_off_ms": max,
}


def main(arguments: list[str] | None = None) -> int:
    """Fly, print a line a flight, write JSON. Returns 1 if a flight left no report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", required=True, metavar="S,S,...", help=f"{BUILT_IN}, or as `uav-recon sim --scene`")
    parser.add_argument("--seeds", required=True, metavar="N,N,...")
    parser.add_argument("--options", default="", metavar="TEXT", help="more options of `uav-recon sim`")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the flight folders in it, as SCENE-SEED")
    options = parser.parse_args(arguments)
    flights = _already_flown(options.json)
    _save(options.json, flights)  # a file that cannot be written is told before the first flight
    failed = 0
    for seed in (int(word) for word in options.seeds.split(",")):
        for scene in options.scenes.split(","):
            if any(flight["scene"] == scene and flight["seed"] == seed for flight in flights):
                continue
            with tempfile.TemporaryDirectory(prefix="uav_recon-seeds-") as temporary:
                folder = (options.keep or Path(temporary)) / f"{Path(scene).name}-{seed}"
                flight = _fly(scene, seed, options.options.split(), folder)
            if flight is None:
                failed += 1
                print(f"{scene} {seed}: no report", flush=True)
                continue
            flights.append(flight)
            print(" ".join(f"{name} {_short(value)}" for name, value in flight.items()), flush=True)
            _save(options.json, flights)
    return int(failed > 0)


def summary(flights: list[Flight]) -> dict[str, Any]:
    """Return median and worst of each figure, and how many flights ended as they should.

    honest_share: of all estimates of scale, mount and delay, those within CALIBRATION_SIGMAS of their deviation.
    """
    figures: dict[str, Any] = {}
    for name, worst in WORST.items():
        values = [flight[name] for flight in flights if flight[name] is not None]
        figures[name] = {"median": statistics.median(values), "worst": worst(values)} if values else None
    sigmas = [abs(x) for flight in flights for x in flight["off_in_sigmas"]]
    honest = sum(x <= CALIBRATION_SIGMAS for x in sigmas) / len(sigmas) if sigmas else None
    completed = sum(flight["outcome"] == "completed" for flight in flights)
    return {"flights": len(flights), "completed": completed, "honest_share": honest, **figures}


def calibration_off(found: Mapping[str, tuple[float, float]] | None, true: CameraErrors) -> dict[str, Any]:
    """Return what the estimated errors of a camera are off by; None for each without an estimate."""
    if not found:
        return {"scale_off": None, "mount_off_deg": None, "delay_off_ms": None, "off_in_sigmas": []}
    truth = {"depth_scale": true.optics.depth_scale, "delay_s": true.timing.age_s} | {
        f"rotation_{axis}_rad": -turn for axis, turn in zip(AXES, true.mount.rotation_rad, strict=True)
    }
    off = {name: found[name][0] - value for name, value in truth.items()}
    return {
        "scale_off": abs(off["depth_scale"]),
        "mount_off_deg": math.degrees(math.hypot(*(off[f"rotation_{axis}_rad"] for axis in AXES))),
        "delay_off_ms": 1e3 * abs(off["delay_s"]),
        "off_in_sigmas": [off[name] / found[name][1] for name in truth],
    }


def _fly(scene: str, seed: int, more: list[str], folder: Path) -> Flight | None:
    """Fly one mission in lockstep into a folder; None if it left no report."""
    file = folder.with_suffix(".json")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)  # a flight that is refused must not leave the report of another
    where = [] if scene == BUILT_IN else ["--scene", scene]
    command = [sys.executable, "-m", "uav_recon", "sim", "--lockstep", *where, "--seed", str(seed), *more]
    subprocess.run([*command, "--out", str(folder), "--json", str(file)], cwd=ROOT, stdout=sys.stderr, check=False)
    try:
        report = json.loads(file.read_bytes())["report"]
        true = CameraErrors.load(folder / "camera_errors.json")
    except (OSError, ValueError, KeyError):
        return None
    quality, safety = report["quality"] or {}, report["safety"]
    return {
        "scene": scene,
        "seed": seed,
        "outcome": report["outcome"],
        **{key: quality.get(key) for key in ("accuracy_cm", "completion_cm", "recall_5cm", "psnr_db")},
        **{key: (report["odometry"] or {}).get(key) for key in ("ate_cm", "shape_accuracy_cm")},
        "explored": report["explored_fraction"],
        "flight_time_s": report["flight_time_s"],
        "min_clearance_m": safety["min_clearance_m"],
        "contacts": safety["contacts"],
        **calibration_off(report["views_calibration"], true),
    }


def _already_flown(path: Path) -> list[Flight]:
    """Return the flights of this commit in a result file; none without one."""
    try:
        tree = json.loads(path.read_bytes())
        return list(tree["missions"]) if tree[result_file.HEADER]["commit"] == host_info.revision()[0] else []
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _save(path: Path, flights: list[Flight]) -> None:
    result_file.save(path, {"summary": summary(flights), "missions": flights})


def _short(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
