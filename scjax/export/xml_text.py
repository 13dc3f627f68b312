"""XML files: numbers as text, and the whole tree as bytes."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from scjax.scene.files import write_file

XmlElement = ElementTree.Element


def add_element(
    parent: XmlElement, tag: str, text: str | None = None, /, **attributes: str | int | float
) -> XmlElement:
    """A new child; numbers become text, floats with 15 digits."""
    child = ElementTree.SubElement(parent, tag, {name: shown_number(value) for name, value in attributes.items()})
    child.text = text
    return child


def add_point(parent: XmlElement, x: float, y: float) -> XmlElement:
    """A <point> with <x> and <y> [m], as CommonRoad has it."""
    point = add_element(parent, "point")
    add_element(point, "x", plain_decimal(x))
    add_element(point, "y", plain_decimal(y))
    return point


def shown_number(value: str | int | float) -> str:
    """A number as XML programs read it; text as it is."""
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def plain_decimal(value: float) -> str:
    """A number with up to 9 decimals and no exponent."""
    text = f"{value:.9f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def write_xml(root: XmlElement, path: Path) -> None:
    """Writes a tree to a file, which appears whole or not at all."""
    ElementTree.indent(root, " ")
    tree = ElementTree.ElementTree(root)
    write_file(path, lambda file: tree.write(file, encoding="utf-8", xml_declaration=True))
