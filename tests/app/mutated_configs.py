"""Start the pilot on N broken configs: `python tests/app/mutated_configs.py [N]`.

Exit code 1: a pilot did not end as it must.
Each config is the flown config with one error: a value just beyond a limit, a value that is not a number, a string for a number
or a table for a string, a missing or misspelt key, or two values that contradict each other. The other end of the pilot's
serial line is in this process, so that everything the pilot sends is seen.
"""

from __future__ import annotations

import argparse
import math
import os
import pty
import resource
import select
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w
from annotated_types import Ge, Gt, Le, Lt

from uav_recon.config import Config, load
from uav_recon.measurement import result_file

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
LONGEST_S = 1.0


@dataclass(frozen=True)
class Mutant:
    """Config that must be refused with a message that names the key and its limit."""

    tree: dict[str, Any]
    words: tuple[str, ...]


def mutants() -> list[Mutant]:
    """Return all mutants, always the same."""
    return [*wrong_numbers(), *wrong_kinds(), *missing_and_misspelt(), *contradictions()]


def flown(section: str, key: str, value: Any) -> dict[str, Any]:
    """Return the flown config with one value changed."""
    tree = load(FLOWN).model_dump(mode="json", exclude_none=True)
    return {**tree, section: {**tree[section], key: value}}


def fields() -> Iterator[tuple[str, str, Any]]:
    """Yield section, key and field of every config value."""
    for section, kind in Config.model_fields.items():
        for key, field in kind.annotation.model_fields.items():  # type: ignore[union-attr]
            yield section, key, field


def wrong_numbers() -> Iterator[Mutant]:
    """Yield values just beyond each limit, far beyond it, and not a number."""
    for section, key, field in fields():
        whole = field.annotation is int
        for bound in field.metadata:
            for limit, away, outside in (
                ("ge", -math.inf, False),
                ("gt", -math.inf, True),
                ("le", math.inf, False),
                ("lt", math.inf, True),
            ):
                if not isinstance(bound, {"ge": Ge, "gt": Gt, "le": Le, "lt": Lt}[limit]):
                    continue
                border = getattr(bound, limit)
                step = int(math.copysign(1, away))
                first = border if outside else border + step if whole else math.nextafter(border, away)
                for value in (first, border + 1000 * step):
                    yield Mutant(flown(section, key, value), (f"{section}.{key}", f"{border:g}"))
            yield Mutant(flown(section, key, math.nan), (f"{section}.{key}",))


def wrong_kinds() -> Iterator[Mutant]:
    """Yield a string for each number and a table for each other value."""
    for section, key, field in fields():
        if field.annotation in (int, float):
            yield Mutant(
                flown(section, key, "much"), (f"{section}.{key}", "number" if field.annotation is float else "integer")
            )
        else:
            yield Mutant(flown(section, key, {"a": 1}), (f"{section}.{key}",))


def missing_and_misspelt() -> Iterator[Mutant]:
    """Yield configs without a protective number and with an unknown key.

    No protective number has a default, and no unknown key is ignored.
    """
    tree = load(FLOWN).model_dump(mode="json", exclude_none=True)
    for key in tree["safety"]:
        less = {name: value for name, value in tree["safety"].items() if name != key}
        yield Mutant({**tree, "safety": less}, (f"safety.{key}", "required"))
    for section in Config.model_fields:
        yield Mutant(flown(section, "no_such_key", 1), (f"{section}.no_such_key", "unknown key"))


def contradictions() -> Iterator[Mutant]:
    """Yield values that are valid one by one but not together."""
    for low, high in (
        ("intent_timeout_s", "retreat_timeout_s"),
        ("retreat_timeout_s", "land_timeout_s"),
        ("depth_timeout_s", "depth_retreat_s"),
        ("depth_retreat_s", "depth_land_s"),
        ("pose_timeout_s", "pose_land_s"),
    ):
        yield Mutant(flown("safety", high, load(FLOWN).model_dump()["safety"][low] - 0.01), (low, "<="))
    for key, most, limit in (
        ("speed_mps", 3.0, "max_speed_mps"),
        ("tight_speed_mps", 3.0, "max_speed_mps"),
        ("climb_mps", 3.0, "max_speed_mps"),
        ("descent_mps", 3.0, "max_speed_mps"),
        ("acceleration_mps2", 5.0, "max_acceleration_mps2"),
        ("yaw_rate_degps", 120.0, "max_yaw_rate_degps"),
    ):
        yield Mutant(flown("motion", key, most), (f"motion.{key}", f"safety.{limit}"))
    for section, key, value, limit in (
        ("camera", "depth_min_m", 6.0, "camera.depth_max_m"),
        ("camera", "depth_max_m", 0.1, "camera.depth_max_m"),
        ("voxels", "max_range_m", 0.2, "voxels.max_range_m"),
        ("voxels", "distance_cap_m", 0.3, "planner.clearance_m"),
        ("voxels", "takeoff_radius_m", 0.1, "safety.vehicle_radius_m"),
        ("safety", "stop_clearance_m", 0.21, "safety.vehicle_radius_m + safety.stop_clearance_m"),
        ("mission", "takeoff_height_m", 2.0, "safety.fence_max_m.2 - safety.fence_inset_m"),
        ("safety", "vehicle_radius_m", 0.31, "safety.fence_inset_m"),
        ("safety", "pose_timeout_s", 0.03, "safety.pose_timeout_s"),
        ("safety", "depth_timeout_s", 0.2, "safety.depth_timeout_s"),
        ("camera", "source", "recorded", "camera.recording"),
        ("link", "signing_key", "/etc/uav_recon/signing.key", "link.autopilot"),
        ("link", "url", "udp:10.41.1.1:14540", "link.peer_host"),
    ):
        yield Mutant(flown(section, key, value), (limit,))
    tree = flown("safety", "fence_max_m", [400.0, 400.0, 50.0])
    yield Mutant(tree, ("voxels.resolution_m", "safety.fence_max_m"))
    for axis in range(3):
        corner_m = list(load(FLOWN).safety.fence_min_m)
        corner_m[axis] = load(FLOWN).safety.fence_max_m[axis] - 0.5
        yield Mutant(flown("safety", "fence_min_m", corner_m), ("fence_min_m", "inset"))
    for corners in (
        [[-3, -3], [3, 3], [3, -3], [-3, 3]],
        [[-3, -3], [3, 3]],
        [[1, -3], [3, -3], [3, 3]],
        [[-3, -3], [9, -3], [0, 3]],
    ):
        yield Mutant(flown("safety", "fence_corners_m", corners), ("fence",))
    for key, most in (("safety.fence_min_m", 500), ("safety.fence_max_m", 500), ("camera.position_body_m", 1)):
        for value in (math.nan, math.inf, most + 0.1, -most - 0.1):
            section, _, name = key.partition(".")
            yield Mutant(flown(section, name, [0.1, value, 0.1]), (f"{key}.1", f"{most} "))
    for url in ("", "tcp:127.0.0.1:5760", "udp:127.0.0.1", "serial:/dev/fc", "udp:127.0.0.1:ten", "/dev/ttyACM0"):
        yield Mutant(flown("link", "url", url), ("link.url", "want "))
    for host in ("", "anybody", "10.41.1", "0.0.0.0/0"):
        yield Mutant(flown("link", "peer_host", host), ("link.peer_host", "want "))


class SerialLine:
    """Serial line whose other end is in this process; ``url`` is its config value."""

    def __init__(self) -> None:
        self._here, self._there = pty.openpty()
        tty.setraw(self._there)
        self.url = f"serial:{os.ttyname(self._there)}:921600"

    def heard(self, timeout_s: float = 0.0) -> bytes:
        """Return the bytes received here within timeout_s, b'' for none."""
        return os.read(self._here, 4096) if select.select([self._here], [], [], timeout_s)[0] else b""

    def close(self) -> None:
        os.close(self._here)
        os.close(self._there)


@dataclass(frozen=True)
class End:
    """Result of one start: fault in the way the pilot ended, '' for none, and its times (s)."""

    fault: str
    processor_s: float
    wall_s: float


def command(tree: dict[str, Any], folder: Path, line: SerialLine) -> list[str]:
    """Return the command that starts the pilot on this config.

    The line replaces the flown link.
    """
    link = tree["link"]
    link = {**link, "url": line.url if link["url"] == load(FLOWN).link.url else link["url"]}
    path = folder / "config.toml"
    path.write_text(tomli_w.dumps({**tree, "link": link, "runtime": {**tree["runtime"], "folder": str(folder / "run")}}))
    return [sys.executable, "-m", "uav_recon", "pilot", "--config", str(path)]


def end_of(mutant: Mutant, folder: Path, line: SerialLine) -> End:
    """Start the pilot on the mutant's config and return how it ended."""
    words = command(mutant.tree, folder, line)
    before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    wall_s, after = time.monotonic() - began_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    lines, sent = done.stderr.splitlines(), line.heard()
    missing = [word for word in mutant.words if word not in lines[0]] if lines else []
    fault = ""
    if done.returncode != 78 or len(lines) != 1 or done.stdout:
        fault = f"exit {done.returncode}, said {done.stdout + done.stderr!r}"
    elif sent or (folder / "run").exists():
        fault = f"it began to run, and sent {sent!r}"
    elif missing:
        fault = f"{lines[0]!r} does not name {missing}"
    return End(fault, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_s)


def main(count: int, json: Path | None = None) -> int:
    """Try count mutants, spread over all of them, and print a summary. Return the exit code."""
    everything = mutants()
    tried = everything[:: max(len(everything) // count, 1)][:count]
    line = SerialLine()
    with tempfile.TemporaryDirectory() as home:
        ends = [end_of(mutant, Path(home), line) for mutant in tried]
    line.close()
    bad = [(mutant, end) for mutant, end in zip(tried, ends, strict=True) if end.fault]
    print(f"{len(ends)} broken configs, {len(bad)} not refused as they must be")
    for name, took_s in (("processor", [end.processor_s for end in ends]), ("wall clock", [end.wall_s for end in ends])):
        print(f"{name} to the end: {sorted(took_s)[len(took_s) // 2]:.2f} s, {max(took_s):.2f} s at most")
    for mutant, end in bad:
        print(f"{mutant.words}: {end.fault}")
    if json is not None:
        longest_s = {name: max(getattr(end, f"{name}_s") for end in ends) for name in ("processor", "wall")}
        result_file.save(json, {"configs": len(ends), "wrong": len(bad), "longest_s": longest_s})
    return int(bool(bad) or max(end.processor_s for end in ends) > LONGEST_S)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    sys.exit(main(options.count, options.json))
