"""The mutants of the guard: each module of safety/ has tests that its mutants are tried with."""

from __future__ import annotations

from pathlib import Path

from mutants import HERE, TESTS

SAFETY = Path(__file__).parents[2] / "uav_recon" / "safety"


def test_each_module_of_safety_has_tests_for_its_mutants() -> None:
    assert set(TESTS) == {path.stem for path in SAFETY.glob("*.py")} - {"__init__"}
    assert all((HERE / f"{name}.py").exists() for names in TESTS.values() for name in names)
