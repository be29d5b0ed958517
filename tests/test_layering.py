"""Check the import rules over every import of the tree. There is no exception list."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BASE = {"types", "interfaces", "config", "clock", "channels", "geometry", "json_codec", "atomic_file"}
STAGES = ("sensors", "localization", "mapping", "planning", "motion", "recording")
ALLOWED = {
    "__init__": {"types", "mapping", "planning", "app"},
    "__main__": {"cli"},
    "types": set(),
    "errors": set(),
    "config_constraints": set(),
    "json_codec": set(),
    "atomic_file": set(),
    "interfaces": {"types"},
    "geometry": {"types"},
    "clock": {"types", "interfaces"},
    "channels": {"types", "interfaces"},
    "config": {"types", "config_constraints", "atomic_file"},
    **dict.fromkeys(STAGES, BASE),
    **{stage: {*BASE, "safety"} for stage in ("mapping", "motion")},  # a rule of the guard has one home
    "safety": {"types"},
    "autopilot": {"types", "interfaces", "clock", "channels", "config", "safety", "atomic_file"},
    "mission": {"types", "interfaces", "clock"},
    "operator": {"types", "interfaces", "json_codec"},
    "evaluation": {"types", "geometry"},
    "trackers": {"types", "interfaces", "sensors"},
    "app": {*BASE, *STAGES, "safety", "autopilot", "mission", "operator", "trackers", "errors"},
    "measurement": {"types", "json_codec", "errors", "atomic_file"},
    "bench": {*BASE, *STAGES, "evaluation", "app", "measurement", "errors"},
    "cli": {"app", "bench", "measurement", "operator", "errors"},
}
ROOMS = {  # rooms of a package, or modules beside them: each imports only those before it
    "autopilot": ("mavlink", "firmware", "link", "parameters", "pilot"),
    "autopilot/pilot": (
        "hull_geometry", "pilot_channels", "situation", "setpoints", "reports", "sequence", "setpoint_stream", "pilot",
        "assembly",
    ),
    "mission": (
        "events", "state_machine", "setup", "log", "trajectory", "battery", "requests", "takeoff", "survey",
        "return_home", "intake", "flight_actions", "detection", "publication", "conductor",
    ),
}  # fmt: skip
USES_SIMULATOR = {"cli"}  # the only package of the product that starts the simulator
SIMULATOR_ROOTS = ("sitl/apps/", "sitl/bench/", "sitl/faults/flights/")  # composition roots: they join simulator and product
HEAVY = {
    "torch": ("uav_recon/mapping/neural/sdf_torch",),
    "pyrealsense2": ("uav_recon/sensors/realsense_device.py",),
    "cyclonedds": ("uav_recon/sensors/ros2",),
    "pymavlink": ("uav_recon/autopilot", "sitl"),
    "rerun": ("uav_recon/recording",),
}
TORCH_FREE = ("uav_recon/mapping/neural/worker/mapper_process.py", "uav_recon/mapping/neural/worker/mapper_client.py")
SAYS_NOTHING = {"utils", "util", "common", "helpers", "helper", "manager", "misc"}
SIMULATED = {"sim", "sitl", "simulated", "simulation", "is_sim"}


def modules(*folders: str) -> list[str]:
    return [str(path.relative_to(ROOT)) for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


@cache
def imports(module: str) -> frozenset[str]:
    """Return the dotted names that a module imports.

    For `from package import name` it is `package.name`.
    """
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def reached_from(*start: str) -> set[str]:
    """Return every module of the project that these modules import, directly or not."""
    seen: set[str] = set()
    todo = list(start)
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        for name in imports(module):
            for candidate in (name, name.rpartition(".")[0]):
                path = candidate.replace(".", "/") + ".py"
                if name.startswith("uav_recon.") and (ROOT / path).exists():
                    todo.append(path)
    return seen


def packages_of(names: set[str] | frozenset[str]) -> set[str]:
    return {name.split(".")[0] for name in names}


def test_a_package_imports_only_what_its_rank_allows() -> None:
    for module in modules("uav_recon"):
        package = module.split("/")[1].removesuffix(".py")
        assert package in ALLOWED, f"{package} has no rank in this table"
        ours = {name.split(".")[1] for name in imports(module) if name.startswith("uav_recon.")}
        assert ours <= ALLOWED[package] | {package}, f"{module} imports {ours - ALLOWED[package] - {package}}"
    for module in ("uav_recon/mission/events.py", "uav_recon/mission/state_machine.py"):
        ours = {name for name in imports(module) if name.startswith("uav_recon.")}
        assert all(name.startswith(("uav_recon.types", "uav_recon.mission")) for name in ours), ours


@pytest.mark.parametrize("house", ROOMS)
def test_a_room_imports_only_those_before_it(house: str) -> None:
    order, dotted = ROOMS[house], f"uav_recon.{house.replace('/', '.')}."
    for module in modules(f"uav_recon/{house}"):
        inside = module.removeprefix(f"uav_recon/{house}/")
        if inside == "__init__.py":
            continue
        rank = order.index(inside.split("/")[0].removesuffix(".py"))
        for name in imports(module):
            if name.startswith(dotted):
                assert order.index(name.removeprefix(dotted).split(".")[0]) <= rank, f"{module} imports {name}"


def test_product_and_simulator_meet_only_in_composition_roots() -> None:
    for module in modules("uav_recon"):
        if module.split("/")[1] not in USES_SIMULATOR:
            assert "sitl" not in packages_of(imports(module)), f"{module} imports the simulator"
        for node in ast.walk(ast.parse((ROOT / module).read_text(encoding="utf-8"))):
            if isinstance(node, ast.If):
                words = {n.id for n in ast.walk(node.test) if isinstance(n, ast.Name)}
                words |= {n.attr for n in ast.walk(node.test) if isinstance(n, ast.Attribute)}
                assert not words & SIMULATED, f"{module}: if {words}"
    for module in modules("sitl"):
        if not module.startswith(SIMULATOR_ROOTS):
            ours = {name for name in imports(module) if name.startswith("uav_recon")}
            assert all(name.startswith("uav_recon.sensors.stream_format") for name in ours), f"{module} imports {ours}"


def test_heavy_packages_stay_where_they_belong() -> None:
    for module in modules("uav_recon", "sitl"):
        for package in packages_of(imports(module)) & set(HEAVY):
            assert module.startswith(HEAVY[package]), f"{module} imports {package}"
    pilot, mapper = reached_from(*modules("uav_recon/autopilot", "uav_recon/safety")), reached_from(*TORCH_FREE)
    assert len(pilot) > 10
    assert len(mapper) > 20
    for module in pilot:
        assert not packages_of(imports(module)) & {"torch", "open3d", "rerun", "cv2", "numba"}, module
    for module in mapper:
        assert "torch" not in packages_of(imports(module)), module


def test_no_module_has_a_meaningless_name() -> None:
    stems = [Path(module).stem for module in modules("uav_recon", "sitl")]
    assert not set(stems) & SAYS_NOTHING
