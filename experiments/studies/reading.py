"""What does the reader understand of prompts whose requests are known? Precision, recall and prompts read in full.

    python -m experiments.studies.reading ../shared/prompts/dev.jsonl --out=docs/results/reading

The file has one prompt a line: {"style", "prompt", "asks"}. An answer is right if it equals what is stated; ends of
distances may differ by 3 m. An ask is implied if every scene that shows what is read shows it. Attributes that no line
of the file states are left out: it does not know them. The last table compares the share that the reader gives with how
often such answers are right.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from experiments.studies.page import command_line, script_parser, table_lines, write_page
from scjax.generate.prompt_reader import load_reader
from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from scjax.language.grammar.styles import is_negative
from scjax.language.reader.targets import Reading
from scjax.nn.startup import start_jax
from scjax.scene.document import parse_document

_TOLERANCE = 3.0  # meters between ends of distances
_INTERSECTIONS = ("four-way", "T", "Y", "multi-intersection")
_BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)


class _Line(msgspec.Struct):
    style: str
    prompt: str
    asks: dict[str, Any]


class Answer(NamedTuple):
    """One attribute of one prompt: what is stated and what is read; None where it is not there."""

    prompt: int
    attribute: str
    stated: Any
    read: Any
    share: float

    @property
    def right(self) -> bool:
        if self.stated is None or self.read is None:
            return False
        if ATTRIBUTES[self.attribute].unit != "m":
            return self.stated == self.read
        return all(_near(*ends) for ends in zip(self.stated, self.read, strict=True))

    @property
    def implied(self) -> bool:
        """Whether every scene that shows what is read shows what is stated."""
        if self.right or self.stated is None or self.read is None:
            return self.right
        kind = ATTRIBUTES[self.attribute].kind
        if kind == "set":
            return set(self.stated) <= set(self.read)
        if kind == "range":
            (least, most), (low, high) = self.stated, self.read
            return low >= least and (most is None or (high is not None and high <= most))
        return self.stated == "intersection" and self.read in _INTERSECTIONS


def _near(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return abs(one - other) <= _TOLERANCE


def compare_readings(requests: Sequence[Mapping[str, Any]], readings: Sequence[Reading]) -> list[Answer]:
    """All attributes that are stated or read, of those that some request states."""
    known = {name for request in requests for name in request}
    answers = []
    for row, (request, reading) in enumerate(zip(requests, readings, strict=True)):
        stated = check_attributes(request)
        for name in sorted(known & {*stated, *reading.request}):
            read, share = reading.request.get(name), reading.shares.get(name, 0.0)
            answers.append(Answer(row, name, stated.get(name), read, share))
    return answers


def summarize(answers: Iterable[Answer], prompts: int) -> dict[str, Any]:
    """Shares of answers, of asks and of the prompts that are read in full, with what they are shares of."""
    some = list(answers)
    right, implied = sum(one.right for one in some), sum(one.implied for one in some)
    read = sum(one.read is not None for one in some)
    stated = sum(one.stated is not None for one in some)
    wrong = len({one.prompt for one in some if not one.right})
    return {
        "prompts": prompts,
        "asks": stated,
        "read": read,
        "precision": right / max(read, 1),
        "recall": right / max(stated, 1),
        "implied": implied / max(stated, 1),
        "full": (prompts - wrong) / max(prompts, 1),
    }


def is_negation(answer: Answer) -> bool:
    """Whether a prompt states that something is not there."""
    return answer.stated is not None and is_negative({answer.attribute: answer.stated})


def is_exact_number(answer: Answer) -> bool:
    """Whether a prompt states a number that is not 0, exactly or as one of three neighbors; gaps are no numbers."""
    attribute = ATTRIBUTES[answer.attribute]
    if answer.stated is None or attribute.kind != "range" or attribute.unit:
        return False
    least, most = answer.stated
    return bool(most) and most - least in (0, 2)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.reading", __doc__)
    parser.add_argument("prompts", type=Path, help="JSONL file of prompts with what they ask for")
    parser.add_argument("--reader", type=Path, help="folder of a reader (default: the one that ships)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        lines = _read_lines(args.prompts)
        for line in lines:
            check_attributes(line.asks)  # before the encoder runs for minutes
        readings = load_reader(args.reader)([line.prompt for line in lines])
        answers = compare_readings([line.asks for line in lines], readings)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.reading: {error}")
    rows = {"all": summarize(answers, len(lines))}
    for style in sorted({line.style for line in lines}):
        own = {row for row, line in enumerate(lines) if line.style == style}
        rows[style] = summarize((one for one in answers if one.prompt in own), len(own))
    attributes = {name: summarize(group, 0) for name, group in _grouped(answers, lambda one: one.attribute).items()}
    kinds = {
        "negations": summarize(filter(is_negation, answers), 0),
        "exact numbers": summarize(filter(is_exact_number, answers), 0),
    }
    page = _page(rows, attributes, kinds, answers, command_line("reading", arguments))
    write_page(args.out, page, {"styles": rows, "attributes": attributes, "kinds": kinds})


def _read_lines(path: Path) -> list[_Line]:
    return [
        parse_document(line, _Line, f"{path}, line {number}", "write style, prompt and asks")
        for number, line in enumerate(path.read_bytes().splitlines(), 1)
    ]


def _grouped(answers: Iterable[Answer], key: Callable[[Answer], str]) -> dict[str, list[Answer]]:
    groups: dict[str, list[Answer]] = {}
    for one in answers:
        groups.setdefault(key(one), []).append(one)
    return dict(sorted(groups.items()))


def _page(
    rows: dict[str, Any], attributes: dict[str, Any], kinds: dict[str, Any], answers: Sequence[Answer], command: str
) -> str:
    shares = ("precision", "recall", "implied", "full")
    styles = [
        [name, str(row["prompts"]), str(row["asks"]), *(f"{row[key]:.0%}" for key in shares)]
        for name, row in rows.items()
    ]
    parts = [[name, str(row["asks"]), f"{row['recall']:.0%}"] for name, row in kinds.items()]
    own = [
        [name, str(row["asks"]), str(row["read"]), *(f"{row[key]:.0%}" for key in shares[:3])]
        for name, row in attributes.items()
    ]
    bins = []
    for low, high in itertools.pairwise(_BINS):
        some = [one for one in answers if one.read is not None and low < one.share <= high]
        if some:
            right = sum(one.right for one in some) / len(some)
            bins.append([f"{low:g} to {high:g}", str(len(some)), f"{right:.0%}"])
    return "\n".join(
        [
            "# Reading of prompts",
            "",
            f"`{command}`",
            "",
            *table_lines(["style", "prompts", "asks", "precision", "recall", "implied", "read in full"], styles),
            "",
            *table_lines(["kind", "stated", "read right"], parts),
            "",
            *table_lines(["attribute", "stated", "read", "precision", "recall", "implied"], own),
            "",
            *table_lines(["share given by the reader", "answers", "right"], bins),
            "",
        ]
    )


if __name__ == "__main__":
    main()
