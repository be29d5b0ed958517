"""Memory and open descriptors of each process, sampled once a second, and their growth."""

from __future__ import annotations

import json
from pathlib import Path

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.injectors.cpu_and_disk_load import resident_bytes
from sitl.faults.injectors.process_signals import MAPPER, RECORDER, processes_of
from sitl.faults.process_registry import ProcessRegistry, child_of
from sitl.faults.report.resource_chart import Track, draw

PROCESSES = ("pilot", "perception", "mission", "mapper", "recorder")
CHILDREN = {"mapper": MAPPER, "recorder": RECORDER}  # children of the mission, found by words in their command lines
PERIOD_S = 1.0
_MEGABYTE = 1e6


class ResourceUsage(Injector):
    """Sampler of the memory and the open descriptors of every process.

    It notes "NAME MB/h" and "NAME descriptors" for each process, and as "ended" the number of processes that ended within
    for_s. At the end all samples are written to soak.json and a chart of them to soak.svg, beside the flight's config. During
    the flight the samples are appended to soak.csv, which remains if the soak is cut short.
    """

    needs = Capabilities.PROCESSES

    def __init__(self, for_s: float) -> None:
        self._for_s = for_s
        self._due_s = 0.0
        self._tracks: dict[str, Track] = {}
        self._ended = 0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Sample every process once a second."""
        if not self._due_s <= since_s <= self._for_s:
            return
        self._due_s = since_s + PERIOD_S
        for name in PROCESSES:
            self._look(name, processes_of(at), since_s)
        self._keep(at, since_s)
        at.notes["ended"] = float(self._ended)

    def end(self, at: InjectionContext) -> None:
        """Compute the growth, and write the samples and the chart."""
        for name, track in self._tracks.items():
            at.notes[f"{name} MB/h"] = track.mb_per_h()
            at.notes[f"{name} descriptors"] = track.more_descriptors()
        assert at.config is not None
        tracks = {name: vars(track) for name, track in self._tracks.items()}
        at.config.with_name("soak.json").write_text(json.dumps(tracks), encoding="utf-8")
        at.config.with_name("soak.svg").write_text(draw(self._tracks), encoding="utf-8")

    def _keep(self, at: InjectionContext, since_s: float) -> None:
        """Append one line to soak.csv."""
        assert at.config is not None
        tracks = [self._tracks.get(name) for name in PROCESSES]
        words = ",".join(f"{track.memory_mb[-1]:.3f},{track.descriptors[-1]}" if track else "," for track in tracks)
        with at.config.with_name("soak.csv").open("a", encoding="utf-8") as lines:
            if not lines.tell():
                lines.write("s," + ",".join(f"{name} MB,{name} descriptors" for name in PROCESSES) + "\n")
            lines.write(f"{since_s:.1f},{words}\n")

    def _look(self, name: str, registry: ProcessRegistry, since_s: float) -> None:
        if name not in self._tracks:
            pid = child_of(registry.pid("mission"), CHILDREN[name]) if name in CHILDREN else registry.pid(name)
            if pid is None:
                return
            self._tracks[name] = Track(pid)
        track = self._tracks[name]
        if memory := resident_bytes(track.pid):
            track.since_s.append(since_s)
            track.memory_mb.append(memory / _MEGABYTE)
            track.descriptors.append(descriptors_of(track.pid))
        else:
            self._ended += 1
            del self._tracks[name]  # its replacement starts a new track


def descriptors_of(pid: int) -> int:
    """Return the number of open files, sockets and pipes of a process; 0 once it has ended."""
    try:
        return len(list(Path(f"/proc/{pid}/fd").iterdir()))
    except OSError:
        return 0
