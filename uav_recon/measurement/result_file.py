"""JSON files of measured values, each with a header of command, machine and date.

Every command with `--json` writes its file here, so that `results/generate.py` can read all of them.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from uav_recon import atomic_file, json_codec
from uav_recon.errors import EXIT_FAILURE, UserError
from uav_recon.measurement import host_info
from uav_recon.measurement.machine_speed import MachineSpeed, measure_machine_speed
from uav_recon.measurement.plausibility import impossible_value

HEADER = "header"
PROGRAM = "uav-recon"


@dataclass(frozen=True)
class ResultHeader:
    """Origin of a result.

    command: as typed; an absolute path below the working directory is made relative, any other is cut to its name.
    commit, changed: of the source tree (host_info.revision). date: end of the run, UTC, ISO 8601.
    reference_job_s: processor time of the job of machine_speed here, raw. contention: wall time / processor time of the
    same job; above 1 other programs used the cores.
    seconds: wall time from the start of the process to the writing of the file.
    """

    command: str
    commit: str
    changed: bool
    date: str
    processor: str
    cores: int
    memory_gib: float
    reference_job_s: float
    contention: float
    seconds: float


def result_header(machine_speed: MachineSpeed | None = None) -> ResultHeader:
    """Return the header of a run that ends now.

    Without a machine_speed it measures one, which takes half a second.
    """
    measured = machine_speed or measure_machine_speed()
    head, changed = host_info.revision()
    return ResultHeader(
        command=command_line(sys.argv, Path.cwd()),
        commit=head,
        changed=changed,
        date=datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
        processor=host_info.processor_name(),
        cores=os.cpu_count() or 0,
        memory_gib=round(host_info.memory_gib(), 1),
        reference_job_s=round(measured.cpu_s, 5),
        contention=round(measured.slowdown / measured.cpu_slowdown, 3),
        seconds=round(host_info.process_age_s(), 1),
    )


def command_line(words: Sequence[str], folder: Path) -> str:
    """Return the words of a process as one shell line without paths of this machine.

    See ResultHeader.command.
    """
    program = Path(words[0])
    ours = program.name in ("__main__.py", PROGRAM)
    first = [PROGRAM] if ours else ["python", _short(words[0], folder)]
    return shlex.join([*first, *(_short(word, folder) for word in words[1:])])


def save(path: Path, values: Mapping[str, Any], header: ResultHeader | None = None) -> None:
    """Write header and values, whole or not at all; a number that is not finite becomes null.

    Raises UserError if the file cannot be written, or for a value that cannot be; see plausibility.
    """
    text = json_codec.to_page({HEADER: header or result_header(), **values})
    if wrong := impossible_value(json.loads(text)):
        raise UserError(f"--json {path}: {wrong}; not written", EXIT_FAILURE)
    try:
        atomic_file.replace(path, text.encode(), durable=False)
    except OSError as error:
        raise UserError(f"--json {path}: cannot be written ({error.strerror})", EXIT_FAILURE) from None


def _short(word: str, folder: Path) -> str:
    path = Path(word)
    if not path.is_absolute():
        return word
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else path.name
