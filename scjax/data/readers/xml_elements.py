"""XML of untrusted files as a light tree: bounded, without entities, every element with its line."""

from __future__ import annotations

import dataclasses
import re
from xml.parsers import expat

from scjax.scene.files import MEGABYTE

MAX_BYTES = 500 * MEGABYTE
MAX_ELEMENTS = 10_000_000
MAX_DEPTH = 64
MAX_TEXT = 10_000  # characters between the tags of one element
OPENDRIVE_SKIPPED = frozenset(
    {"userData", "include", "objects", "railroad", "surface", "roadMark", "material", "dataQuality"}
)
"""Elements of OpenDRIVE that nobody needs; they are most of a file, and are left out with all that is in them."""

_CURE = "correct the file, or export it again"


@dataclasses.dataclass(slots=True)
class Element:
    """One XML element.

    Attributes:
      tag: name without a namespace.
      attributes: texts by name.
      line: where it starts in the file, from 1.
      children: elements in it, in order.
      content: text between its tags, before its first child.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element]
    content: str = ""

    def all(self, tag: str) -> list[Element]:
        """The children of this name, in order."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """The first child of this name."""
        return next((child for child in self.children if child.tag == tag), None)

    def only(self, tag: str) -> Element:
        """The first child of this name; ValueError if there is none."""
        child = self.first(tag)
        if child is None:
            raise self.fault(f"has no <{tag}>")
        return child

    def text(self, name: str, default: str | None = None) -> str:
        """An attribute; ValueError if it is missing and has no default."""
        value = self.attributes.get(name, default)
        if value is None:
            raise self.fault(f"has no {name}")
        return value.strip()

    def number(self, name: str, default: float | None = None, most: float = 1e9) -> float:
        """A finite number of a size up to ``most``; ValueError if it is none, or missing without a default."""
        if default is not None and name not in self.attributes:
            return default
        return self._finite(name, self.text(name), most)

    def value(self, most: float = 1e9) -> float:
        """The finite number between the tags; ValueError if it is none."""
        return self._finite("its text", self.content.strip(), most)

    def _finite(self, name: str, text: str, most: float) -> float:
        try:
            value = float(text)
        except ValueError as error:
            raise self.fault(f"{name} is {text!r:.40}, not a number") from error
        if not abs(value) <= most:
            raise self.fault(f"{name} is {value:g}: it must be finite and at most {most:g} in size")
        return value

    def whole(self, name: str) -> int:
        """A whole number; ValueError if it is none or missing."""
        text = self.text(name)
        try:
            return int(text)
        except ValueError as error:
            raise self.fault(f"{name} is {text!r:.40}, not a whole number") from error

    def fault(self, reason: str) -> ValueError:
        """The error that says where in the file something is wrong."""
        identity = self.attributes.get("id")
        name = f"<{self.tag}>" if identity is None else f"<{self.tag} id={identity[:40]!r}>"
        return ValueError(f"line {self.line}, {name}: {reason}: {_CURE}")


def parse_elements(data: bytes, skipped: frozenset[str] = OPENDRIVE_SKIPPED) -> Element:
    """The root of an XML text.

    Args:
      skipped: names of elements that are left out, with all in them.

    Raises:
      ValueError: it is too large or too deep, no XML, damaged, or defines entities; says in which line.
    """
    if len(data) > MAX_BYTES:
        raise ValueError(f"it has {len(data) // MEGABYTE} MB, more than {MAX_BYTES // MEGABYTE}: split the map")
    builder = _Builder(skipped)
    try:
        builder.parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise ValueError(f"line {error.lineno}: no sound XML ({reason}): copy or export the file again") from error
    except (LookupError, UnicodeError) as error:  # an encoding that Python does not know
        raise ValueError(f"no sound XML ({error}): {_CURE}") from error
    assert builder.root is not None  # expat refuses a text without an element
    return builder.root


def has_root(head: bytes, tag: bytes) -> bool:
    """Whether the first element of an XML text, of which ``head`` is the beginning, has this name."""
    root = re.search(
        rb"<(?:[\w.-]+:)?([A-Za-z_][\w.-]*)", re.sub(rb"<!--.*?-->|<[?!][^>]*>", b"", head, flags=re.DOTALL)
    )
    return root is not None and root[1] == tag


class _Builder:
    """Handlers of one expat parser that build the tree."""

    def __init__(self, skipped: frozenset[str]):
        self.parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.EntityDeclHandler = self._refuse_entity
        parser.CharacterDataHandler = self._add_text
        parser.buffer_text = True
        self.root: Element | None = None
        self._open: list[Element] = []
        self._skipped = skipped
        self._depth = self._skip_depth = self._count = 0

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f"line {self.parser.CurrentLineNumber}: more than {MAX_DEPTH} nested elements: {_CURE}")
        tag = name.rpartition(":")[2]
        if self._skip_depth or tag in self._skipped:
            self._skip_depth += 1
            return
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise ValueError(f"more than {MAX_ELEMENTS} elements: split the map")
        element = Element(tag, attributes, self.parser.CurrentLineNumber, [])
        if self._open:
            self._open[-1].children.append(element)
        elif self.root is None:
            self.root = element
        self._open.append(element)

    def _end(self, name: str) -> None:
        self._depth -= 1
        if self._skip_depth:
            self._skip_depth -= 1
        else:
            self._open.pop()

    def _add_text(self, text: str) -> None:
        if self._skip_depth or not self._open or not (text := text.strip()):
            return
        element = self._open[-1]
        if element.children:
            return
        element.content += text
        if len(element.content) > MAX_TEXT:
            raise ValueError(f"line {element.line}: <{element.tag}> holds more than {MAX_TEXT} characters: {_CURE}")

    def _refuse_entity(self, name: str, *_: object) -> None:
        line = self.parser.CurrentLineNumber
        raise ValueError(f"line {line}: defines the entity {name[:40]!r}, which could fill the memory: remove it")
