"""The house rules of CONTRIBUTING.md that a program can check: levels, sizes, unique names, plain words."""

from __future__ import annotations

import ast
import collections
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LEVELS = (
    ("scene",),
    ("nn", "metrics", "camera"),
    ("language", "encoders", "models", "viz"),
    ("diffusion", "data"),
    ("synthetic", "towns", "generate", "export"),
    ("outpainting",),
    ("sim",),
    ("train", "evaluate", "convert"),
    ("cli",),
)
LEVEL = {package: level for level, packages in enumerate(LEVELS) for package in packages}
MAX_FILE_LINES, MAX_FUNCTION_LINES = 400, 80
SHARED_NAMES = {"main", "get_config"}  # entry points, one per command or config file
PRIVATE_WORDS = re.compile(
    r"(?<![a-z])(told|wanted|asked|handed|tidy|hints|waves|tall|soundness|staging|backwards|stand_in)(?![a-z])"
)


def _sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@functools.cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def _nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(_tree(path)))


def _imports(path: Path) -> Iterator[tuple[int, str]]:
    """(line, dotted module) of every import, also of those inside functions."""
    for node in _nodes(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def _package(path: Path) -> str | None:
    """The package of scjax that a file belongs to; None for entry points and scjax/__init__.py."""
    parts = path.relative_to(ROOT / "scjax").parts
    return None if len(parts) == 1 or path.name == "__main__.py" else parts[0]


def _identifiers(path: Path) -> Iterator[tuple[int, str]]:
    for node in _nodes(path):
        if isinstance(node, ast.Name):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.value.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name


def _assert_none(faults: list[str]) -> None:
    assert not faults, "\n" + "\n".join(faults)


def test_every_package_has_a_level():
    packages = {path.parent.name for path in (ROOT / "scjax").glob("*/__init__.py")}
    assert packages == set(LEVEL)


def test_imports_point_to_lower_levels():
    upward = [
        f"{_name(path)}:{line} imports {module}"
        for path in _sources("scjax")
        if (package := _package(path)) is not None
        for line, module in _imports(path)
        if module.startswith("scjax.")
        if (target := module.split(".")[1]) in LEVEL and target != package and LEVEL[target] >= LEVEL[package]
    ]
    _assert_none(upward)


def test_scjax_imports_neither_experiments_nor_benchmarks():
    _assert_none(
        [
            f"{_name(path)}:{line} imports {module}"
            for path in _sources("scjax")
            for line, module in _imports(path)
            if module.split(".")[0] in ("experiments", "benchmarks", "consumers", "tests")
        ]
    )


def test_benchmarks_import_scjax_only():
    _assert_none(
        [
            f"{_name(path)}:{line} imports {module}"
            for path in _sources("benchmarks")
            for line, module in _imports(path)
            if module.split(".")[0] in ("experiments", "tests")
        ]
    )


def test_test_modules_import_no_test_modules():
    _assert_none(
        [
            f"{_name(path)}:{line} imports {module}"
            for path in _sources("tests")
            for line, module in _imports(path)
            if module.startswith("tests.") and not module.startswith("tests.factories")
        ]
    )


@pytest.mark.parametrize("folder", ["scjax", "experiments", "benchmarks", "consumers", "tests"])
def test_files_are_short(folder):
    lengths = {_name(path): len(path.read_text(encoding="utf-8").splitlines()) for path in _sources(folder)}
    _assert_none([f"{name}: {lines} lines" for name, lines in lengths.items() if lines > MAX_FILE_LINES])
    assert sorted(lengths.values())[len(lengths) // 2] < 200


def test_functions_are_short():
    _assert_none(
        [
            f"{_name(path)}:{node.lineno} {node.name}: {lines} lines"
            for path in _sources("scjax", "experiments", "benchmarks", "consumers")
            for node in _nodes(path)
            if isinstance(node, ast.FunctionDef)
            if (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
        ]
    )


def test_public_names_are_unique():
    places = collections.defaultdict(set)  # overloads of a function are in one file
    for path in _sources("scjax"):
        for node in _tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].add(_name(path))
    doubles = {name: files for name, files in places.items() if len(files) > 1 and name not in SHARED_NAMES}
    _assert_none([f"{name}: {', '.join(sorted(files))}" for name, files in doubles.items()])


def test_identifiers_are_plain_words():
    _assert_none(
        [
            f"{_name(path)}:{line} {name}"
            for path in _sources("scjax", "experiments")
            for line, name in _identifiers(path)
            if PRIVATE_WORDS.search(name)
        ]
    )


def test_backend_is_asked_in_one_package():
    _assert_none(
        [
            _name(path)
            for path in _sources("scjax")
            if "nn/cpu/" not in _name(path) and "default_backend" in path.read_text(encoding="utf-8")
        ]
    )


def test_import_of_scjax_needs_no_optional_packages():
    """Heavy packages of single readers, exports and parity checks are imported where they are used."""
    heavy = {"torch", "tensorflow", "transformers", "shapely", "tensorboardX"}
    _assert_none(
        [
            f"{_name(path)}:{node.lineno}"
            for path in _sources("scjax")
            for node in _tree(path).body
            if isinstance(node, ast.Import | ast.ImportFrom)
            for module in ([node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names])
            if module and module.split(".")[0] in heavy
        ]
    )
