"""Check docstrings, comments and names against the rules of CONTRIBUTING.md."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_FIRST_LINE = 90
WORDS = (
    "anew|whoever|heeds?|heeded|forsake|forsaken|aloft|borne|nought|stewards?|clerks?|heralds?|meddlers?|vigils?|theatres?"
    "|cartographers?|credence|bury|buries|buried|witness|witnesses"
)
BANNED = re.compile(rf"\b({WORDS}|so (long|much|far|many)|told of|in vain|all of a sudden)\b", re.IGNORECASE)
BANNED_IN_NAMES = re.compile(WORDS)
BANNED_NAMES = {"_raise_again", "TWO"}
PART_OF_NAME = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
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


def names(path: Path) -> Iterator[tuple[int, str]]:
    """Yield each name that a module gives, with its line: of a class, function, parameter, variable or attribute."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def banned_names(path: Path) -> Iterator[str]:
    """Yield the names with a word that is no term of the field, with file and line."""
    for line, name in names(path):
        parts = [part.lower() for part in PART_OF_NAME.findall(name)]
        if name in BANNED_NAMES or any(BANNED_IN_NAMES.fullmatch(part) for part in parts):
            yield f"{path}:{line}: banned: {name}"


def banned_words(path: Path) -> Iterator[str]:
    """Yield the banned words of docstrings and comments, with file and line."""
    for line, text in texts(path):
        for word in BANNED.finditer(text):
            yield f"{path}:{line}: banned: {word.group()!r}"


def faults(path: Path) -> Iterator[str]:
    """Yield what breaks a rule, with file and line."""
    for line, text in texts(path):
        first = text.splitlines()[0]
        if not text.startswith("#") and len(first) > MAX_FIRST_LINE:
            yield f"{path}:{line}: first line has {len(first)} characters, at most {MAX_FIRST_LINE}"
        if not text.startswith("#") and CLAUSE.match(first):
            yield f"{path}:{line}: starts with a clause: {first}"


def modules(*folders: str) -> list[Path]:
    """Return the modules below some folders."""
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def test_docstrings_begin_with_a_short_line() -> None:
    found = [fault for path in modules("uav_recon", "sitl", "examples") for fault in faults(path)]
    assert not found, "\n".join(found)


def test_docstrings_and_comments_are_plain_english() -> None:
    everything = [path for path in modules("uav_recon", "sitl", "examples", "results", "tests") if path != Path(__file__)]
    found = [fault for path in everything for fault in banned_words(path)]
    assert not found, "\n".join(found)


def test_names_are_terms_of_the_field() -> None:
    found = [fault for path in modules("uav_recon", "sitl", "examples", "results", "tests") for fault in banned_names(path)]
    assert not found, "\n".join(found)


def test_the_rules_find_what_they_forbid(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(f'"""Whether it flies."""\n# made anew\n\n\ndef f():\n    """{"x" * 91}."""\n')
    assert len(list(faults(module))) == 2
    assert len(list(banned_words(module))) == 1
    module.write_text(
        "TWO = 2\n\n\nclass LinkClerk:\n    def _bury(self, the_meddler, standing):\n        self.witnesses = two = 2\n"
    )
    assert {fault.rsplit(" ", 1)[1] for fault in banned_names(module)} == {
        "TWO", "LinkClerk", "_bury", "the_meddler", "witnesses",
    }  # fmt: skip
