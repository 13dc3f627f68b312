"""Requests for attributes in a short form for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def shown_request(request: Mapping[str, Any]) -> str:
    """ "layout T, vehicles 3 to 5" for a request in its normal form."""
    return ", ".join(f"{name} {shown_value(value)}" for name, value in request.items())


def shown_value(value: Any) -> str:
    """A value of a request in its normal form: "3 to 5", "2 or more", "yes", "left and right"."""
    if isinstance(value, tuple) and value and isinstance(value[0], int | float):
        least, most = value
        return f"{least:g}" if least == most else f"{least:g} or more" if most is None else f"{least:g} to {most:g}"
    if isinstance(value, tuple):
        return " and ".join(value)
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
