"""Check docstrings and comments against the rules of CONTRIBUTING.md."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_FIRST_LINE = 90
BANNED = re.compile(
    r"\b(anew|whoever|heeds?|heeded|forsake\w*|aloft|borne|nought|so (long|much|far|many)|told of|in vain|all of a sudden"
    r"|stewards?|clerks?|heralds?|meddlers?|vigils?|theatre|cartographers?|credence)\b",
    re.IGNORECASE,
)
CLAUSE = re.compile(r"(Whether|What|How|Of|As|The same|Who|Whose|Where|When|Why)\b")


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each docstring and comment of a module, with its line."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node)
            if docstring:
                yield node.body[0].lineno, docstring
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def faults(path: Path) -> Iterator[str]:
    """Yield what breaks a rule, with file and line."""
    for line, text in texts(path):
        first = text.splitlines()[0]
        for word in BANNED.finditer(text):
            yield f"{path}:{line}: banned: {word.group()!r}"
        if not text.startswith("#") and len(first) > MAX_FIRST_LINE:
            yield f"{path}:{line}: first line has {len(first)} characters, at most {MAX_FIRST_LINE}"
        if not text.startswith("#") and CLAUSE.match(first):
            yield f"{path}:{line}: starts with a clause: {first}"


def test_docstrings_and_comments_are_plain_english() -> None:
    found = [
        fault
        for folder in ("uav_recon", "sitl", "examples")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for fault in faults(path)
    ]
    assert not found, "\n".join(found)


def test_the_rules_find_what_they_forbid(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(f'"""Whether it flies."""\n# made anew\n\n\ndef f():\n    """{"x" * 91}."""\n')
    assert len(list(faults(module))) == 3
