"""Configs on the command line: a built-in variant or a Python file, with changes as --config.FIELD=VALUE."""

from __future__ import annotations

import ast
import difflib
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ml_collections import ConfigDict

GetConfig = Callable[[str], ConfigDict]
"""variant -> config, as ``get_config`` of a config file."""

_PREFIX = "--config."


def load_config(text: str, get_config: GetConfig, overrides: Sequence[str] = ()) -> ConfigDict:
    """The locked config that a command runs with.

    Args:
      text: a variant of ``get_config``, or "FILE.py" or "FILE.py:VARIANT" with a ``get_config`` of its own.
      get_config: makes the built-in configs.
      overrides: remaining command-line arguments, "--config.FIELD=VALUE" or "--config.FIELD" and "VALUE".

    Raises:
      ValueError: an unknown variant, file, field or value.
    """
    path, _, variant = text.partition(".py")
    if path != text:
        get_config, text = _from_file(Path(f"{path}.py")), variant.removeprefix(":")
    config = (get_config(text) if text else get_config()).lock()  # pyright: ignore[reportCallIssue]
    for field, value in _pairs(overrides):
        _set(config, field, value)
    return config


def _from_file(path: Path) -> Callable[..., ConfigDict]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"--config={path}: there is no such file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, "get_config"):
        raise ValueError(f"--config={path}: the file defines no get_config")
    return module.get_config


def _pairs(arguments: Sequence[str]) -> list[tuple[str, str]]:
    pairs, rest = [], list(arguments)
    while rest:
        argument = rest.pop(0)
        field, equals, value = argument.removeprefix(_PREFIX).partition("=")
        if not argument.startswith(_PREFIX) or not (equals or rest):
            raise ValueError(f"unexpected argument {argument!r}: change fields with {_PREFIX}FIELD=VALUE")
        pairs.append((field, value if equals else rest.pop(0)))
    return pairs


def _set(config: ConfigDict, field: str, text: str) -> None:
    *folders, name = field.split(".")
    node: Any = config
    for folder in folders:
        node = node[folder] if isinstance(node, ConfigDict) and folder in node else None
    if not isinstance(node, ConfigDict) or name not in node:
        known = [path for path, _ in _leaves(config)]
        near = difflib.get_close_matches(field, known, 1)
        raise ValueError(f"{_PREFIX}{field}: there is no such field" + (f"; do you mean {near[0]}?" if near else ""))
    try:
        node[name] = _value(text, node[name])
    except (ValueError, SyntaxError, TypeError) as error:
        expected = type(node[name]).__name__
        raise ValueError(f"{_PREFIX}{field}={text}: expected a value of type {expected}, as {node[name]!r}") from error


def _leaves(config: ConfigDict, prefix: str = "") -> list[tuple[str, Any]]:
    leaves = []
    for name, value in config.items():
        leaves += _leaves(value, f"{prefix}{name}.") if isinstance(value, ConfigDict) else [(f"{prefix}{name}", value)]
    return leaves


def _value(text: str, default: Any) -> Any:
    """``text`` as a value of the type of ``default``."""
    if isinstance(default, str):
        return text
    if isinstance(default, bool):
        values = {"true": True, "1": True, "false": False, "0": False}
        if text.lower() not in values:
            raise ValueError(text)
        return values[text.lower()]
    if isinstance(default, int | float):
        return type(default)(text)
    value = ast.literal_eval(text)
    if isinstance(default, tuple):
        return tuple(value) if isinstance(value, tuple | list) else (value,)
    if default is not None and not isinstance(value, type(default)):
        raise TypeError(text)
    return value
