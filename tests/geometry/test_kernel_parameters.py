"""Bound the number of positional parameters of kernels: mypy does not see a swapped pair of arrays."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "uav_recon"
DECORATORS = ("kernel", "fast_kernel")
MAX_PARAMETERS = 11


def kernels(path: Path) -> Iterator[ast.FunctionDef]:
    """Yield the kernels of a module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and any(ast.unparse(one) in DECORATORS for one in node.decorator_list):
            yield node


def test_no_kernel_has_too_many_positional_parameters() -> None:
    found = {f"{path.stem}.{one.name}": len(one.args.args) for path in PACKAGE.rglob("*.py") for one in kernels(path)}
    assert len(found) > 200
    assert {name: count for name, count in found.items() if count > MAX_PARAMETERS} == {}
