"""Who may import whom: walks every import of the tree. There is no exception list."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BASE = {"types", "protocols", "config", "clock", "channels", "geometry"}
ALLOWED = {
    "types": {"types"},
    "protocols": {"types", "protocols"},
    "config": {"types", "config", "relations"},
    "relations": set(),
    "clock": {"types", "protocols", "clock"},
    "channels": {"types", "protocols", "channels"},
    "failure": set(),
    "wires": {"types", "protocols", "channels", "failure"},
    "geometry": {"types", "geometry"},
    **{stage: BASE | {stage} for stage in ("sensors", "localization", "mapping", "planning", "motion", "recording")},
    "safety": {"types", "safety"},
    "autopilot": {"types", "protocols", "clock", "channels", "config", "safety", "autopilot"},
    "mission": {"types", "protocols", "clock", "mission"},
    "operator": {"types", "protocols", "operator"},
    "evaluation": {"types", "geometry", "evaluation"},
    "notify": set(),
    "steady": set(),
}
ROOTS = {"run", "run_desk", "processes", "refine", "params", "bench", "usage"} | {
    "cli",
    "cli_exit",
    "cli_faults",
    "cli_params",
    "cli_operator",
}
ROOT_IMPORTS = {
    "cli": {"run", "processes", "refine", "bench", "cli_exit", "cli_faults", "cli_params", "cli_operator"},
    "cli_operator": {"run", "run_desk", "cli_exit", "operator", "failure"},
    "run_desk": {*ALLOWED, "run"},
    "usage": {"failure"},
    "processes": {*ALLOWED, "run", "run_desk", "usage"},
    "cli_exit": {"failure"},
    "cli_params": {"params", "cli_exit"},
    "cli_faults": {"cli_exit"},
    "params": {*ALLOWED, "run", "usage"},
    "run": set(ALLOWED),
    "refine": {*ALLOWED, "run", "processes", "usage"},
    "bench": {*ALLOWED, "run", "processes", "bench", "usage"},
}
HEAVY = {
    "torch": {"uav_recon/mapping/neural/tensor"},
    "pyrealsense2": {"uav_recon/sensors/realsense.py"},
    "pymavlink": {"uav_recon/autopilot", "sitl"},
    "rerun": {"uav_recon/recording"},
}
PILOT_FORBIDS = {"torch", "open3d", "rerun", "cv2", "numba"}


def modules(folder: str) -> list[Path]:
    return sorted(p for p in (ROOT / folder).rglob("*.py"))


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def stage_of(path: Path) -> str:
    parts = path.relative_to(ROOT / "uav_recon").with_suffix("").parts
    return parts[0]


@pytest.mark.parametrize("path", modules("uav_recon"), ids=lambda p: str(p.relative_to(ROOT)))
def test_a_stage_imports_only_what_its_rank_allows(path: Path) -> None:
    stage = stage_of(path)
    if stage == "__init__":
        return
    ours = {name.split(".")[1] for name in imports(path) if name.startswith("uav_recon.") and name.count(".") >= 1}
    outside = {name for name in imports(path) if name.split(".")[0] == "sitl"}
    if stage in ROOTS:
        assert ours <= ROOT_IMPORTS.get(stage, set(ALLOWED) | {"run"}), f"{path.name} imports {ours}"
        return
    assert not outside, f"{path.name} imports the simulation: {outside}"
    assert stage in ALLOWED, f"{stage} has no rank in this table"
    assert ours <= ALLOWED[stage], f"{path.name} imports {ours - ALLOWED[stage]}"


def test_the_machine_and_the_events_import_types_only() -> None:
    for name in ("events.py", "machine.py"):
        ours = {i for i in imports(ROOT / "uav_recon/mission" / name) if i.startswith("uav_recon.")}
        assert all(i.startswith(("uav_recon.types", "uav_recon.mission")) for i in ours), ours


@pytest.mark.parametrize("path", modules("sitl"), ids=lambda p: str(p.relative_to(ROOT)))
def test_the_outside_world_shares_only_the_wire_format(path: Path) -> None:
    if path.name.startswith("fly"):
        return
    ours = {name for name in imports(path) if name.startswith("uav_recon")}
    assert all(name.startswith("uav_recon.sensors.stream_format") for name in ours), f"{path.name} imports {ours}"


@pytest.mark.parametrize("path", modules("uav_recon") + modules("sitl"), ids=lambda p: str(p.relative_to(ROOT)))
def test_heavy_packages_stay_in_their_room(path: Path) -> None:
    where = str(path.relative_to(ROOT))
    for name in imports(path):
        rooms = HEAVY.get(name.split(".")[0])
        assert rooms is None or any(where.startswith(room) for room in rooms), f"{where} imports {name}"


def reached_from(start: list[Path]) -> dict[Path, set[str]]:
    """Every module of ours that these import, directly or not, and what each imports."""
    seen: dict[Path, set[str]] = {}
    todo = list(start)
    while todo:
        path = todo.pop()
        if path in seen:
            continue
        seen[path] = imports(path)
        for name in seen[path]:
            if name.startswith("uav_recon."):
                for candidate in (name, name.rpartition(".")[0]):
                    file = ROOT / (candidate.replace(".", "/") + ".py")
                    if file.exists():
                        todo.append(file)
    return seen


def test_the_pilot_reaches_no_heavy_package() -> None:
    reached = reached_from(modules("uav_recon/autopilot") + modules("uav_recon/safety"))
    for path, names in reached.items():
        assert not {name.split(".")[0] for name in names} & PILOT_FORBIDS, path
    assert len(reached) > 10


def test_the_guard_stays_small_enough_to_be_read() -> None:
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in modules("uav_recon/safety"))
    assert lines <= 800


def test_the_mapper_in_flight_reaches_no_torch() -> None:
    reached = reached_from(
        [ROOT / "uav_recon/mapping/neural/worker/mapper_process.py", ROOT / "uav_recon/mapping/neural/worker/mapper_client.py"]
    )
    for path, names in reached.items():
        assert not any(name.split(".")[0] == "torch" for name in names), path
    assert len(reached) > 20


@pytest.mark.parametrize("path", modules("uav_recon") + modules("sitl"), ids=lambda p: str(p.relative_to(ROOT)))
def test_files_are_one_noun(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400
    assert path.stem not in {"utils", "util", "common", "helpers", "helper", "manager", "misc"}


def test_the_product_does_not_know_that_it_is_simulated() -> None:
    for path in modules("uav_recon"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.If):
                words = {n.id for n in ast.walk(node.test) if isinstance(n, ast.Name)}
                words |= {n.attr for n in ast.walk(node.test) if isinstance(n, ast.Attribute)}
                assert not words & {"sim", "sitl", "simulated", "simulation", "is_sim"}, f"{path}: if {words}"
