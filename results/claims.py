"""Claims and results: reading them, and comparing each figure with its requirement."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uav_recon.measurement.plausibility import impossible_value

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Tree = dict[str, Any]

ROOT = Path(__file__).parents[1]
CLAIMS = "results/claims.toml"
CURRENT = "results/current"
MAX_CONTENTION = 1.15  # wall time / processor time of the job of machine_speed, above which a timing is not used
REQUIREMENTS = ("at_most", "at_least", "equals")
ROUNDING = 1e-9  # relative; so that a limit that is met exactly is met after scaling too


class ClaimError(Exception):
    """Claim or JSON file that cannot be evaluated; its text is one line with file and key."""


@dataclass(frozen=True)
class Run:
    """A command that writes results/current/NAME.json."""

    name: str
    command: str
    minutes: float
    long: bool = False

    @property
    def path(self) -> str:
        """Path of the JSON file, relative to the repository root."""
        return f"{CURRENT}/{self.name}.json"

    @property
    def command_line(self) -> str:
        """The command with the path of the JSON file in it."""
        return self.command.replace("{json}", self.path)


@dataclass(frozen=True)
class Figure:
    """One number of a claim with its requirement; see the head of claims.toml."""

    name: str
    key: str
    unit: str = ""
    digits: int | None = None
    scale: float = 1.0
    divided_by: str = ""
    at_most: float | None = None
    at_least: float | None = None
    equals: str | None = None

    @property
    def requirement(self) -> str:
        """The comparison as text; '' if the figure is reported only."""
        if self.equals is not None:
            return f"= {self.equals}"
        sign, limit = ("≤" if self.at_most else "=", self.at_most) if self.at_most is not None else ("≥", self.at_least)
        if limit is None:
            return ""
        number = f"{limit:,.0f}" if float(limit).is_integer() else f"{limit:g}"
        return f"{sign} {number} {self.unit}".rstrip()

    def holds(self, value: float | str | None) -> bool | None:
        """Return whether a value meets the requirement; None if there is none.

        An unknown value (None) meets no requirement.
        """
        if self.equals is not None:
            return value == self.equals
        limit = self.at_most if self.at_most is not None else self.at_least
        if limit is None:
            return None
        if not isinstance(value, float):
            return False
        slack = ROUNDING * abs(limit)
        return value <= limit + slack if self.at_most is not None else value >= limit - slack

    def text(self, value: float | str | None) -> str:
        """Return a value with its unit, rounded to `digits` (default: 2, none for whole numbers)."""
        if value is None:
            return "not measured"
        if isinstance(value, str):
            return value
        digits = self.digits if self.digits is not None else 0 if value == int(value) and self.scale == 1.0 else 2
        return f"{value:,.{digits}f} {self.unit}".rstrip()

    def worst(self, values: list[float | str | None]) -> float | str | None:
        """Return the value furthest from the requirement; an unknown one is worse than any."""
        for value in values:
            if value is None or (self.equals is not None and value != self.equals):
                return value
        numbers = [value for value in values if isinstance(value, float)]
        if len(numbers) < len(values):
            return values[0]
        return min(numbers) if self.at_least is not None else max(numbers)


@dataclass(frozen=True)
class Claim:
    """Sentence, and figures that support it.

    unmeasured: why there is no result, while there is none. note: file in results/notes/ with an earlier measurement.
    """

    id: str
    claim: str
    runs: tuple[Run, ...]
    figures: tuple[Figure, ...]
    unmeasured: str = ""
    note: str = ""
    timing: bool = False


@dataclass(frozen=True)
class Headline:
    """A line of the table in README.md: the one value of a figure of a claim."""

    text: str
    claim: str
    figure: str


@dataclass(frozen=True)
class ClaimOutcome:
    """Measured values of a claim in the order of its figures, and headers of its runs.

    reason: why there are no values; '' if there are. files: names of the runs that have a JSON file. stale: measured too
    many commits ago, see revision_age.
    """

    claim: Claim
    values: tuple[float | str | None, ...] = ()
    headers: tuple[Tree, ...] = field(default=())
    reason: str = ""
    files: tuple[str, ...] = ()
    stale: bool = False

    @property
    def measured(self) -> bool:
        """True if there are values."""
        return not self.reason

    @property
    def passed(self) -> bool:
        """True if every figure with a requirement meets it."""
        return self.measured and all(
            figure.holds(value) is not False for figure, value in zip(self.claim.figures, self.values, strict=True)
        )

    @property
    def commit(self) -> str:
        """Commits of the runs, '+changed' appended where the source tree differed."""
        return ", ".join(dict.fromkeys(str(h["commit"]) + ("+changed" if h["changed"] else "") for h in self.headers))

    @property
    def date(self) -> str:
        """The date of the last run, ISO 8601."""
        return max(str(header["date"]) for header in self.headers)


def load_claims(root: Path = ROOT) -> tuple[tuple[Claim, ...], dict[str, Run]]:
    """Return the claims in their order, and all runs by name.

    Raises ClaimError for a file that makes no sense.
    """
    tree = _tree(root)
    try:
        runs = {name: Run(name=name, **table) for name, table in tree["run"].items()}
        claims = tuple(_claim(table, runs) for table in tree["claim"])
    except (KeyError, TypeError) as error:
        raise ClaimError(f"{CLAIMS}: {error}") from None
    ids = [claim.id for claim in claims]
    if len(set(ids)) < len(ids):
        raise ClaimError(f"{CLAIMS}: claim {max(ids, key=ids.count)} is there twice")
    used = {run.name for claim in claims for run in claim.runs}
    if used != set(runs):
        raise ClaimError(f"{CLAIMS}: no claim uses run {', '.join(sorted(set(runs) - used))}")
    return claims, runs


def load_headlines(claims: Sequence[Claim], root: Path = ROOT) -> tuple[Headline, ...]:
    """Return the lines of the table in README.md.

    Raises ClaimError for a line whose figure no claim has.
    """
    try:
        headlines = tuple(Headline(**table) for table in _tree(root)["headline"])
    except (KeyError, TypeError) as error:
        raise ClaimError(f"{CLAIMS}: headline: {error}") from None
    known = {(claim.id, figure.name) for claim in claims for figure in claim.figures}
    for line in headlines:
        if (line.claim, line.figure) not in known:
            raise ClaimError(f"{CLAIMS}: headline {line.text!r}: claim {line.claim} has no figure {line.figure!r}")
    return headlines


def _tree(root: Path) -> Tree:
    return tomllib.loads((root / CLAIMS).read_text(encoding="utf-8"))


def _claim(table: Tree, runs: dict[str, Run]) -> Claim:
    names = table.pop("run")
    figures = tuple(_figure(table["id"], figure) for figure in table.pop("figures"))
    claim = Claim(runs=tuple(runs[name] for name in ([names] if isinstance(names, str) else names)), figures=figures, **table)
    if not any(figure.requirement for figure in figures):
        raise ClaimError(f"{CLAIMS}: claim {claim.id} has no requirement")
    return claim


def _figure(claim: str, table: Tree) -> Figure:
    figure = Figure(**table)
    if sum(getattr(figure, name) is not None for name in REQUIREMENTS) > 1:
        raise ClaimError(f"{CLAIMS}: claim {claim}: {figure.name}: more than one of {', '.join(REQUIREMENTS)}")
    return figure


def load_results(runs: dict[str, Run], root: Path = ROOT) -> dict[str, Tree]:
    """Return the JSON of every run that has one.

    Raises ClaimError for a file that cannot be read, that no run writes, or with a value that cannot be.
    """
    found: dict[str, Tree] = {}
    for path in sorted((root / CURRENT).glob("*")):
        if path.suffix != ".json" or path.stem not in runs:
            raise ClaimError(f"{CURRENT}/{path.name}: no run of {CLAIMS} writes this file")
        try:
            found[path.stem] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ClaimError(f"{CURRENT}/{path.name}: not JSON: {error}") from None
        try:
            wrong = impossible_value(found[path.stem])
        except KeyError as error:
            raise ClaimError(f"{CURRENT}/{path.name}: no {error} there") from None
        if wrong:
            raise ClaimError(f"{CURRENT}/{path.name}: {wrong}")
    return found


def evaluate(claim: Claim, results: dict[str, Tree]) -> ClaimOutcome:
    """Compare a claim with the results of its runs.

    Raises ClaimError naming file and key where a key is missing, or where the runs are of several commits.
    """
    files = tuple(run.name for run in claim.runs if run.name in results)
    missing = [run.path for run in claim.runs if run.name not in results]
    if missing:
        reason = claim.unmeasured or "no result yet"
        if files:
            reason = f"no {', '.join(missing)} yet"
        return ClaimOutcome(claim, reason=reason, files=files)
    headers = tuple(at(results[run.name], "header", run.path) for run in claim.runs)
    _require_one_commit(claim, results)
    contention = max(_number(header, "contention", run.path) for header, run in zip(headers, claim.runs, strict=True))
    if claim.timing and contention > MAX_CONTENTION:
        reason = f"other programs used the cores (contention {contention:.2f}, at most {MAX_CONTENTION} is used)"
        return ClaimOutcome(claim, reason=reason, files=files)
    values = (figure.worst([_value(figure, results[run.name], run.path) for run in claim.runs]) for figure in claim.figures)
    return ClaimOutcome(claim, tuple(values), headers, files=files)


def _require_one_commit(claim: Claim, results: dict[str, Tree]) -> None:
    """Raise ClaimError if a claim has figures of two commits: of two runs, or of the flights of one."""
    first = ""
    for run in claim.runs:
        tree = results[run.name]
        commits = [("header/commit", str(at(tree, "header/commit", run.path)))]
        if isinstance(summary := tree.get("summary"), dict):
            commits += [("summary/commits", str(commit).removesuffix("+changed")) for commit in summary.get("commits", ())]
        for key, commit in commits:
            first = first or commit
            if commit != first:
                raise ClaimError(f"{run.path}: {key}: {commit}; allowed: {first}, as the other figures of claim {claim.id}")


def _value(figure: Figure, tree: Tree, file: str) -> float | str | None:
    """Return the figure as displayed: divided and scaled; None where the file says null."""
    value = at(tree, figure.key, file)
    if value is None:
        return None
    if figure.equals is not None:
        return str(value)
    number = _number(tree, figure.key, file)
    if figure.divided_by:
        number /= _number(tree, figure.divided_by, file)
    return number * figure.scale


def _number(tree: Tree, key: str, file: str) -> float:
    value = at(tree, key, file)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ClaimError(f"{file}: {key}: {value!r} is not a number")
    return float(value)


def at(tree: Any, key: str, file: str) -> Any:
    """Return the value at a path of keys separated by '/'.

    Raises ClaimError naming file and key.
    """
    here = tree
    for part in key.split("/"):
        name, equals, wanted = part.partition("=")
        try:
            if equals:
                here = next(element for element in here if str(element[name]) == wanted)
            else:
                here = here[int(part)] if isinstance(here, list) else here[part]
        except (KeyError, IndexError, TypeError, ValueError, StopIteration):
            raise ClaimError(f"{file}: {key}: no {part!r} there") from None
    return here
