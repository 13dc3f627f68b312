"""JSON from outside, checked against a type: every message names the file and the path of the field.

The types are msgspec structs or dataclasses; ``json_schema`` publishes them for other programs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec


def parse_document(data: bytes | str, expected: Any, name: str | Path, cure: str) -> Any:
    """The JSON text ``data`` as a value of the type ``expected``.

    Args:
      name: what messages begin with: the file.
      cure: what the user shall do, for the end of a message.

    Raises:
      ValueError: the text is no JSON, or a field is missing, of another type or out of its range.
    """
    try:
        return msgspec.json.decode(data, type=expected)
    except RecursionError as error:
        raise ValueError(f"{name}: its lists are nested too deeply: {cure}") from error
    except msgspec.ValidationError as error:
        raise ValueError(f"{name}: {_located(error)}: {cure}") from error
    except (msgspec.DecodeError, UnicodeError) as error:
        try:
            content = json.loads(data)  # reads NaN and Infinity, which JSON does not have but many programs write
        except (ValueError, RecursionError):
            raise ValueError(f"{name} is no JSON ({error}; it may be cut short): {cure}") from error
        return convert_document(content, expected, name, cure)


def convert_document(content: Any, expected: Any, name: str | Path, cure: str) -> Any:
    """As ``parse_document``, of values that are parsed already."""
    try:
        return msgspec.convert(content, expected)
    except (msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"{name}: {_located(error)}: {cure}") from error
    except UnicodeError as error:  # halves of surrogate pairs
        raise ValueError(f"{name}: a text holds characters that are none ({error}): {cure}") from error


def json_schema(document: type) -> dict[str, Any]:
    """The JSON Schema (2020-12) of a type of documents."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(document)}


def _located(error: Exception) -> str:
    """The message of msgspec with the path of the field first."""
    text, _, path = str(error).partition(" - at `")
    path = path.removesuffix("`").removeprefix("$").removeprefix(".")
    text = f"{text[:1].lower()}{text[1:]}"
    return f"{path}: {text}" if path else text
