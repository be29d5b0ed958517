"""Mutants of a cosmic-ray session: `python tests/safety/mutants.py SESSION [SECONDS]`.

Each is tried in a forked process. --json FILE writes the counts.

cosmic-ray makes the mutants and keeps the answers; only the trying is done here, because a process of its own for each of
three thousand takes hours for its imports. Tries what has no answer yet, in a shuffled order, so that a run cut short after
SECONDS is a fair sample and the next one goes on. Prints the survivors and the score; exit 1 below 95 %.

Left out: what runs no code (annotations, which are never evaluated) and what is no program (it does not compile). Tests that
draw at random are not run: the same mutant dies each time or never.
"""

from __future__ import annotations

import argparse
import ast
import functools
import gc
import importlib
import importlib.util
import os
import random
import resource
import sys
import time
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cosmic_ray.ast import get_ast
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkResult

from uav_recon.measurement import result_file
from uav_recon.types.pose import Pose

HERE = Path(__file__).parent
BY_GUARD = ("test_guard_limits", "test_guard", "test_safety_values")
TESTS = {
    "envelope": ("test_envelope", *BY_GUARD),
    "guard": BY_GUARD,
    "depth_age_limit": ("test_depth_age_limit", *BY_GUARD),
    "free_space_check": ("test_free_space_check", *BY_GUARD),
    "setpoint_continuity": ("test_setpoint_continuity", *BY_GUARD),
    "failsafe": ("test_failsafe", "test_safety_values"),
    "failsafe_precedence": ("test_failsafe", "test_safety_values"),
    "refusals": ("test_refusals", "test_guard"),
    "pose_gate": ("test_pose_gate", "test_safety_values"),
    "obstacle_speed_limit": ("test_obstacle_speed_limit", *BY_GUARD),
    "recently_seen_space": ("test_recently_seen_space", *BY_GUARD),
    "sight_speed_limit": ("test_sight_speed_limit", *BY_GUARD),
    "takeoff_view": ("test_takeoff_view",),
    "free_cone_memory": ("test_free_cone_memory",),
    "free_cone_rule": ("test_free_cone_rule", "test_free_cone_memory"),
}
AT_RANDOM = "not nothing_invalid_ever_leaves and not nothing_hostile_reaches"
NEEDLESS = ("dash", "terminal", "cacheprovider", "unraisableexception", "threadexception", "hypothesispytest")
OPTIONS = ["-x", "-o", "addopts=", "--assert=plain", *[f"-pno:{name}" for name in NEEDLESS], "-k", AT_RANDOM]
LONGEST_CPU_S = 15  # all of them take three
NO_PROGRAM = 77  # the exit code of a process whose mutant does not compile
WANTED = 0.95


@functools.cache
def tree_of(path: Path) -> Any:
    """The syntax tree of a file; a forked process may change its own."""
    return get_ast(path.read_text(encoding="utf-8"))


@functools.cache
def annotations_of(path: Path) -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
    """Where the annotations of a file begin and end, as line and column."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            found.append(node.returns)
        elif isinstance(node, ast.arg | ast.AnnAssign):
            found.append(node.annotation)
    return tuple(
        ((node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0)) for node in found if node is not None
    )


def runs_no_code(mutant: MutationSpec) -> bool:
    """Whether a mutant stands in an annotation."""
    return any(start <= mutant.start_pos and mutant.end_pos <= end for start, end in annotations_of(mutant.module_path))


def source_of(mutant: MutationSpec) -> str:
    """The whole file with this mutant in it. Spoils tree_of() for this process."""
    operator = get_operator(mutant.operator_name)(**mutant.operator_args)
    return str(MutationVisitor(mutant.occurrence, operator).walk(tree_of(mutant.module_path)).get_code())


def load_mutant(mutant: MutationSpec) -> None:
    """Put the mutant where its module will be looked for. Raises SyntaxError for what is no program."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # `is` beside a number compiles
        code = compile(source_of(mutant), str(mutant.module_path), "exec")
    package = ".".join(mutant.module_path.parent.parts)
    name = f"{package}.{mutant.module_path.stem}"
    importlib.import_module(package)
    spec = importlib.util.spec_from_file_location(name, mutant.module_path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    exec(code, module.__dict__)
    setattr(sys.modules[package], mutant.module_path.stem, module)


class Trial:
    """A pytest plugin: where tests would be collected, one process is forked for each mutant, and only that one goes on."""

    def __init__(self, db: Any, seconds: float) -> None:
        self._db = db
        self._seconds = seconds
        self._first = os.getpid()

    def is_forked(self) -> bool:
        """Whether this is a forked process."""
        return os.getpid() != self._first

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self, session: pytest.Session) -> bool | None:
        """True in the first process, when all is tried; None in a forked one, which collects and runs the tests."""
        warm_up()
        gc.disable()  # collecting is dearer than what a forked process could gain by it
        gc.freeze()
        end_s = time.monotonic() + self._seconds
        if self._try(session, sorted(set().union(*TESTS.values())), None):
            raise pytest.UsageError("the tests fail without a mutant")
        if self.is_forked():
            return None
        todo = sorted(self._db.pending_work_items, key=lambda item: str(item.job_id))
        random.Random(1).shuffle(todo)
        for item in todo:
            (mutant,) = item.mutations
            if time.monotonic() > end_s:
                break
            if runs_no_code(mutant):
                self._db.set_result(item.job_id, WorkResult(WorkerOutcome.SKIPPED))
                continue
            code = self._try(session, TESTS[mutant.module_path.stem], mutant)
            if self.is_forked():
                return None
            if code == NO_PROGRAM:
                self._db.set_result(item.job_id, WorkResult(WorkerOutcome.SKIPPED))
                continue
            outcome = TestOutcome.KILLED if code else TestOutcome.SURVIVED
            self._db.set_result(item.job_id, WorkResult(WorkerOutcome.NORMAL, test_outcome=outcome))
        return True

    def _try(self, session: pytest.Session, names: Iterable[str], mutant: MutationSpec | None) -> int:
        """The exit code of the tests in a process of their own, negative for a signal: 0 if none notices. In that process 0."""
        child = os.fork()
        if child != 0:
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_CPU_S, LONGEST_CPU_S))
        session.config.args = [str(HERE / f"{name}.py") for name in names]
        if mutant is not None:
            try:
                load_mutant(mutant)
            except SyntaxError:
                os._exit(NO_PROGRAM)
            except Exception:
                os._exit(1)  # a module that cannot be imported fails all its tests
        return 0


def warm_up() -> None:
    """Import what no mutant changes, and load its kernels."""
    importlib.import_module("hypothesis.strategies")
    for name in ("maps", "min_range_grid", "trajectory", "polygon"):
        importlib.import_module(f"uav_recon.types.{name}")
    (Pose.from_yaw(0.1, np.zeros(3)) @ Pose.identity()).apply(np.zeros((2, 3)))


def name_of(mutant: MutationSpec) -> str:
    """One line for a person."""
    row, column = mutant.start_pos
    line = mutant.module_path.read_text(encoding="utf-8").splitlines()[row - 1].strip()
    operator = mutant.operator_name.removeprefix("core/")
    return f"{mutant.module_path}:{row}:{column} {operator} #{mutant.occurrence}: {line}"


def main(session: str, seconds: float, json: Path | None = None) -> int:
    """Try what is left, then print. Returns the exit code."""
    with use_db(session, WorkDB.Mode.open) as db:
        trial, code = Trial(db, seconds), 1
        try:
            code = int(pytest.main(OPTIONS, plugins=[trial]))
        finally:
            if trial.is_forked():
                os._exit(code)
        return report(db, json) if code == pytest.ExitCode.NO_TESTS_COLLECTED else code


def report(db: Any, json: Path | None) -> int:
    """Print survivors and score. Returns the exit code."""
    mutants = {item.job_id: item.mutations[0] for item in db.work_items}
    answers = dict(db.results)
    tried = [job for job, answer in answers.items() if answer.worker_outcome is not WorkerOutcome.SKIPPED]
    alive = [mutants[job] for job in tried if answers[job].test_outcome is TestOutcome.SURVIVED]
    for line in sorted(map(name_of, alive)):
        print(line)
    score = 1.0 - len(alive) / max(len(tried), 1)
    left_out = len(answers) - len(tried)
    print(f"{len(mutants)} mutants, {left_out} left out, {len(tried)} tried, {len(alive)} survived: score {score:.2%}")
    if json is not None:
        counts = {"mutants": len(mutants), "left_out": left_out, "tried": len(tried), "survived": len(alive), "score": score}
        result_file.save(json, counts)
    return int(score < WANTED)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("session")
    parser.add_argument("seconds", type=float, nargs="?", default=float("inf"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    sys.exit(main(options.session, options.seconds, options.json))
