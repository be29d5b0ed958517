"""Every number that is compared where reactions are decided is in docs/limits.md, with its unit, decision and reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from results.claims import ROOT, ClaimError
from results.limits_page import Value, all_limits, constants_of, limits_of, limits_page, shown, value_of
from uav_recon.config import SafetyConfig

DECIDING = (  # here a constant that is compared must be on the page
    "safety",
    "autopilot/pilot",
    "autopilot/link",
    "mission",
    "localization/consistency/depth_consistency.py",
    "localization/fusion/filter_pose_gates.py",
    "localization/fusion/fusion_filter.py",
    "localization/fusion/fusion_history.py",
    "localization/consistency/odometry_drift_rate.py",
    "localization/consistency/past_view_comparison.py",
    "localization/perception",
    "localization/fusion/pose_stream_health.py",
    "localization/fusion/relocalization_check.py",
    "localization/slam/rest_detection.py",
    "localization/slam/tracking_monitor.py",
)


def deciding(module: str) -> bool:
    return any(module == f"uav_recon/{name}" or module.startswith(f"uav_recon/{name}/") for name in DECIDING)


def imported(tree: ast.Module) -> dict[str, tuple[str, str]]:
    """Return the module and the name behind each name that a module imports from the product."""
    return {
        alias.asname or alias.name: (f"{node.module.replace('.', '/')}.py", alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("uav_recon")
        for alias in node.names
    }


def names_in(node: ast.AST) -> set[str]:
    """Return the names in an expression, and the attributes of `self` and of modules."""
    found = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
    return found | {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}


def compared_in(tree: ast.AST) -> set[str]:
    """Return the names that a module compares, directly or through a variable of the same function."""
    found: set[str] = set()
    for scope in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.Module)):
        here = {name for node in ast.walk(scope) if isinstance(node, ast.Compare) for name in names_in(node)}
        for node in ast.walk(scope) if isinstance(scope, ast.FunctionDef) else ():
            if isinstance(node, ast.Assign) and any(names_in(target) & here for target in node.targets):
                found |= names_in(node.value)
        found |= here
    return found


def compared(root: Path) -> Iterator[tuple[str, str]]:
    """Yield module and name of each constant of the deciding modules that is compared anywhere in the product."""
    sources = {str(path.relative_to(root)): path.read_text(encoding="utf-8") for path in (root / "uav_recon").rglob("*.py")}
    numbers = {
        (module, name.rpartition(".")[2])
        for module, source in sources.items()
        if deciding(module)
        for name, (_, _, value) in constants_of(source).items()
        if value is not None and name.rpartition(".")[2].isupper()
    }
    for module, source in sorted(sources.items()):
        tree = ast.parse(source)
        origin = imported(tree)
        if not deciding(module) and not any(deciding(where) for where, _ in origin.values()):
            continue
        for name in sorted(compared_in(tree)):
            if (found := origin.get(name, (module, name))) in numbers:
                yield found


def test_every_constant_that_is_compared_is_on_the_page() -> None:
    listed = {(limit.module, limit.name.rpartition(".")[2]) for limit in all_limits()}
    missing = sorted(
        {f"{module}: {name}" for module, name in compared(ROOT)} - {f"{module}: {name}" for module, name in listed}
    )
    assert not missing, f"want a comment '#: decision: sentence': {missing}"


def test_a_new_constant_is_found_wherever_and_however_it_is_compared(tmp_path: Path) -> None:
    mission, app = tmp_path / "uav_recon" / "mission", tmp_path / "uav_recon" / "app"
    mission.mkdir(parents=True)
    app.mkdir()
    (mission / "battery.py").write_text(
        "import enum\n_A_S = 1.0\n_B_S = 2.0\nC_S = 3.0\n_UNUSED_S = 4.0\n_D = 5\n_TEXT = 'x'\n\n\n"
        "class Kind(enum.IntEnum):\n    E = 1\n\n\n"
        "class Policy:\n    HIGH_M = 2.0\n\n    def ends(self, age_s, kind, name):\n"
        "        wait_s = _B_S if kind == Kind.E else 0.0\n"
        "        return age_s > _A_S or age_s > wait_s or self.HIGH_M > max(age_s, _D) or name == _TEXT\n"
    )
    (app / "loop.py").write_text(
        "from uav_recon.mission.battery import C_S as LIMIT_S\n\n\ndef late(age_s):\n    return age_s > LIMIT_S\n"
    )
    (app / "other.py").write_text("_OTHER_S = 1.0\n\n\ndef late(age_s):\n    return age_s > _OTHER_S\n")
    module = "uav_recon/mission/battery.py"
    assert set(compared(tmp_path)) == {(module, name) for name in ("_A_S", "_B_S", "C_S", "_D", "HIGH_M")}


def test_a_mark_gives_value_decision_and_reason() -> None:
    source = (
        "import math\n\nA_S = 0.5  #: hold: silent for longer\n#: land: silent for much longer,\n#: as B1 shows\n"
        "B_S = 4 * A_S\n\n\n"
        "class Gate:\n    turn_rad: float = math.radians(8.0)  #: reject: a larger turn\n"
    )
    told = [(limit.name, limit.value, limit.decision, limit.why) for limit in limits_of(source, "m.py")]
    assert told == [
        ("A_S", 0.5, "hold", "silent for longer"),
        ("B_S", 2.0, "land", "silent for much longer, as B1 shows"),
        ("Gate.turn_rad", pytest.approx(0.13963, abs=1e-5), "reject", "a larger turn"),
    ]


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("A_S = 1.0  #: silent for longer\n", r"m\.py:1: A_S: want '#: decision: sentence'"),
        ("A_S = 1.0  #: explode: silent for longer\n", "want '#: decision: sentence'"),
        ("A = 1.5  #: hold: silent for longer\n", "A: a number that is no count wants its unit"),
        ("A_S, B_S = 1.0, 2.0  #: hold: silent for longer\n", r"m\.py:1: a comment '#:' wants one constant"),
        ("#: hold: silent for longer\n\nA_S = 1.0\n", r"m\.py:1: a comment '#:' wants one constant"),
        ("A_S = f(1.0)  #: hold: silent for longer\n", "no number that the page can show"),
        ("#: hold: silent for longer\nA_S = f(1.0)\n", "no number that the page can show"),
    ],
)
def test_a_wrong_mark_is_an_error_that_names_the_line(source: str, fault: str) -> None:
    with pytest.raises(ClaimError, match=fault):
        list(limits_of(source, "m.py"))


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("_A_S", 0.5, "0.5 s"),
        ("Gate.turn_rad", 0.13962634, "0.14 rad (8°)"),
        ("_MIN_SHARE", 0.2, "20 %"),
        ("_B_PER_S", 0.002, "0.2 %/s"),
        ("_LATE_NS", 100_000_000, "0.1 s"),
        ("_TURNED_COS", 0.99984770, "cos 1°"),
        ("MIN_VERSION", (1, 15, 4), "1.15.4"),
        ("_REFUSALS", 3, "3"),
        ("_SIZES_M", ((0.2, 0.1), (0.0, 0.0)), "((0.2, 0.1), (0, 0)) m"),
        ("_STEP_DEG", 1.5, "1.5°"),
        ("_ANY", 0.5, ""),
    ],
)
def test_values_are_shown_with_their_unit(name: str, value: Value, text: str) -> None:
    assert shown(name, value) == text


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2.0**32 / 1000", 2.0**32 / 1000),
        ("-(1 << 3) // A", -4),
        ("(A, 0.5)", (2, 0.5)),
        ("True", None),
        ("f(2)", None),
        ("'2'", None),
    ],
)
def test_simple_expressions_have_a_value(text: str, value: object) -> None:
    assert value_of(ast.parse(text, mode="eval").body, {"A": 2}) == value


def test_every_safety_key_stands_before_the_constants() -> None:
    head, _, constants = limits_page().partition("## Constants")
    rows = [line for line in head.splitlines() if line.startswith("| `") and "| none |" in line]
    assert [row.split("`")[1] for row in rows] == list(SafetyConfig.model_fields)
    assert "| `intent_timeout_s` | none | 0.5 | > 0, ≤ 5 | Mission silent for longer: hold. |" in head
    assert (
        "| `_LINK_HOLD_S` | 0.5 s | hold | Autopilot silent for longer: it may no longer follow the setpoints. |" in constants
    )
