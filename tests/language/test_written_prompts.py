"""Written prompts: every line is sound, none is a prompt of people, and mistakes of typing change no request."""

from __future__ import annotations

import collections

import numpy as np
import pytest

from scjax.language.attributes.table import ATTRIBUTES
from scjax.language.grammar.phrasebook import languages
from scjax.language.grammar.prompts import retype, written_prompts


def test_prompts_are_many_and_distinct():
    prompts = written_prompts()
    texts = collections.Counter(one.text.lower() for one in prompts)
    assert len(prompts) > 20_000 and max(texts.values()) == 1
    assert {one.language for one in prompts} == set(languages())


def test_prompts_ask_for_every_attribute():
    named = collections.Counter(name for one in written_prompts() for name in one.request)
    assert set(named) == set(ATTRIBUTES) and min(named.values()) >= 20
    assert any(not one.request for one in written_prompts())


def test_retyped_prompts_ask_for_the_same():
    rng = np.random.default_rng(0)
    prompts = written_prompts()[::40]
    again = [retype(one, rng) for one in prompts]
    assert [one.request for one in again] == [one.request for one in prompts]
    changed = sum(one.text != other.text for one, other in zip(again, prompts, strict=True))
    assert 0.1 * len(prompts) < changed < 0.9 * len(prompts)


@pytest.mark.parametrize(
    ("name", "line", "fault"),
    [
        ("en-terse", "two cars", r"en-terse\.tsv:1: write a prompt, a tab"),
        ("en-terse", "\t{}", r"en-terse\.tsv:1: write a prompt, a tab"),
        ("en-terse", "two cars\t{", "the request is wrong"),
        ("en-terse", 'two cars\t{"cars": 2}', "there is no attribute 'cars'"),
        ("en-terse", 'two cars\t{"vehicles": 0, "ahead": 2}', "ahead and vehicles contradict"),
        ("en-song", "two cars\t{}", "there is no style 'song'"),
    ],
)
def test_wrong_lines_are_named(name, line, fault, tmp_path):
    (tmp_path / f"{name}.tsv").write_text(line + "\n")
    with pytest.raises(ValueError, match=fault):
        written_prompts(tmp_path)
