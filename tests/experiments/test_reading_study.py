"""The study of readings: what counts as right, and its page."""

from __future__ import annotations

import json

import pytest

from experiments.studies import reading
from scjax.generate.prompt_reader import load_reader
from scjax.language.reader.targets import Reading

REQUESTS = [{"vehicles": 2, "pedestrians": 0}, {"gap_ahead": [7, 13]}, {}]


def test_right_answers_are_those_that_are_equal_or_near():
    readings = [
        Reading({"vehicles": (2, 2), "slope": "up"}, {"vehicles": 0.9, "slope": 0.6}),
        Reading({"gap_ahead": (9, 15), "pedestrians": (1, None)}, {"gap_ahead": 0.8, "pedestrians": 0.5}),
        Reading({}, {}),
    ]
    answers = reading.compare_readings(REQUESTS, readings)
    found = {(one.prompt, one.attribute): one.right for one in answers}
    assert found == {
        (0, "vehicles"): True,
        (0, "pedestrians"): False,
        (1, "gap_ahead"): True,
        (1, "pedestrians"): False,
    }
    rows = reading.summarize(answers, 3)
    assert (rows["asks"], rows["read"], rows["full"]) == (3, 3, pytest.approx(1 / 3))
    assert (rows["precision"], rows["recall"]) == (pytest.approx(2 / 3), pytest.approx(2 / 3))


@pytest.mark.parametrize(("ends", "right"), [((5, 13), True), ((3, 13), False), ((7, None), False)])
def test_ends_of_distances_may_differ_a_little(ends, right):
    (answer,) = reading.compare_readings(REQUESTS[1:2], [Reading({"gap_ahead": ends}, {"gap_ahead": 1.0})])
    assert answer.right is right


@pytest.mark.parametrize(
    ("stated", "read", "implied"),
    [
        ({"vehicles": [1, None]}, (2, 3), True),
        ({"vehicles": [2, 3]}, (1, 3), False),
        ({"vehicles": [2, 3]}, (2, None), False),
        ({"event": ["cut-in"]}, ("cut-in", "jaywalker"), True),
        ({"layout": "intersection"}, "T", True),
        ({"layout": "T"}, "intersection", False),
    ],
)
def test_narrower_readings_imply_what_is_stated(stated, read, implied):
    ((name, _),) = stated.items()
    (answer,) = reading.compare_readings([stated], [Reading({name: read}, {name: 1.0})])
    assert answer.implied is implied


def test_page_has_a_row_for_every_style(tmp_path):
    """With readings that ship, which need no encoder."""
    texts = list(load_reader().readings)[:2]
    lines = [{"style": "everyday", "prompt": text, "asks": {"layout": "T"}} for text in texts]
    path = tmp_path / "prompts.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    reading.main([str(path), "--out", str(tmp_path / "page")])
    content = json.loads((tmp_path / "page.json").read_text())
    assert content["styles"]["all"] == content["styles"]["everyday"]
    assert content["styles"]["all"]["prompts"] == len(texts)
    assert "| everyday |" in (tmp_path / "page.md").read_text()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "line 1"),
        ('{"style": "terse", "prompt": "a"}', "asks"),
        ('{"style": "a", "prompt": "b", "asks": {"cars": 1}}', "cars"),
    ],
)
def test_wrong_lines_end_the_command_with_one_line(line, message, tmp_path, monkeypatch):
    """Before any prompt is read."""
    monkeypatch.setattr(reading, "load_reader", None)
    path = tmp_path / "prompts.jsonl"
    path.write_text(line)
    with pytest.raises(SystemExit, match=rf"^experiments\.studies\.reading: .*{message}"):
        reading.main([str(path), "--out", str(tmp_path / "page")])
    assert not (tmp_path / "page.md").exists()
