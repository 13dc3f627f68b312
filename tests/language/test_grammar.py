"""The grammar: what its texts ask for holds on their scenes, its phrasings are many and distinct, its numbers exact."""

from __future__ import annotations

import collections
import functools
import itertools
import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.language.analysis.scene_analysis import analyze
from scjax.language.attributes.contradictions import find_contradictions
from scjax.language.attributes.draw import full_request
from scjax.language.attributes.roads import LAYOUTS
from scjax.language.attributes.table import ATTRIBUTES, check_attributes, measure_attributes, score_attributes
from scjax.language.grammar import phrasebook as phrasebook_module
from scjax.language.grammar.compose import compose, compose_freely
from scjax.language.grammar.noise import add_typing_errors, drop_punctuation
from scjax.language.grammar.page import captions_page
from scjax.language.grammar.phrasebook import SLOTS, languages, phrasebook
from scjax.language.grammar.prompts import written_prompts
from scjax.language.grammar.quantities import KINDS, UNITS, draw_distance, draw_quantity
from scjax.language.grammar.wordings import choose_alternatives, fill, number_text, usable_templates
from scjax.language.reader.numbers import find_numbers
from tests.factories.event_scenes import emergency_corridor
from tests.factories.road_scenes import intersection, intersection_with_signal, roundabout, straight_road, turn_lane
from tests.factories.synthetic_scenes import example_worlds, scenes_of

ROOT = Path(__file__).resolve().parents[2]
SEEDS = st.integers(0, 2**32 - 1)


@functools.cache
def analyses():
    """Scenes of synthetic worlds and drawn ones."""
    scenes = [scene for world in example_worlds()[:5] for _, scene in itertools.islice(scenes_of(world), 3)]
    scenes += [
        straight_road(2, 1).scene(),
        intersection(12, 0, (90, 180, -90)).scene(),
        intersection_with_signal(2).scene(),
        roundabout().scene(),
        turn_lane("left").scene(),
        emergency_corridor(0.7).scene(),
    ]
    return [(analysis, measure_attributes(analysis)) for analysis in map(analyze, scenes)]


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_composed_request_holds_on_its_scene(seed):
    rng = np.random.default_rng(seed)
    analysis, measured = analyses()[int(rng.integers(len(analyses())))]
    caption = compose(measured, rng)
    assert caption.request and check_attributes(caption.request) == caption.request
    assert score_attributes(analysis, caption.request).misses == {}, caption
    assert not caption.contradictions


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, contradicts=st.booleans())
def test_free_compositions_contradict_themselves_only_where_they_say_so(seed, contradicts):
    caption = compose_freely(np.random.default_rng(seed), contradicts=contradicts)
    assert check_attributes(caption.request) == caption.request
    assert not find_contradictions(caption.request)
    assert contradicts or not caption.contradictions
    assert not set(caption.contradictions) & set(caption.request)


def test_most_free_compositions_contradict_themselves_where_they_shall():
    rng = np.random.default_rng(0)
    captions = [compose_freely(rng, language="en", contradicts=True) for _ in range(50)]
    assert sum(bool(caption.contradictions) for caption in captions) >= 45


def test_scenes_are_free_of_contradictions():
    """Every measurement as a request; a rule that found one would be wrong."""
    for _, measured in analyses():
        assert find_contradictions(full_request(measured)) == []


@pytest.mark.parametrize(
    ("request_", "pair"),
    [
        ({"vehicles": 0, "ahead": 2}, ("ahead", "vehicles")),
        ({"one_way": True, "lanes_opposite": 2}, ("one_way", "lanes_opposite")),
        ({"layout": "T", "not_layout": "T"}, ("layout", "not_layout")),
        ({"event": ["jaywalker"], "pedestrians": 0}, ("event", "pedestrians")),
        ({"where": ["cyclists left"], "cyclists": 0}, ("where", "cyclists")),
        ({"lanes_same": 3, "lanes_opposite": 3, "lanes_total": 4}, ("lanes_same", "lanes_total")),
        ({"gap_ahead": (0, 10), "ahead": 0}, ("gap_ahead", "ahead")),
    ],
)
def test_contradictions_are_found(request_, pair):
    assert find_contradictions(request_) == [pair]


def test_a_wrong_way_driver_comes_against_a_one_way_road():
    request = {"one_way": True, "lanes_opposite": 0, "oncoming": (1, None)}
    assert find_contradictions(request) == [("one_way", "oncoming"), ("oncoming", "lanes_opposite")]
    assert find_contradictions({**request, "event": ("wrong-way",)}) == []


def test_asides_ask_for_nothing_and_stand_in_many_texts():
    """Texts of asides alone are empty requests, and no phrasing is an aside."""
    rng = np.random.default_rng(0)
    captions = [compose_freely(rng, language="en") for _ in range(200)]
    empty = [caption for caption in captions if not caption.request]
    assert 2 <= len(empty) <= 20 and all(caption.text for caption in empty)
    book = phrasebook("en")
    phrasings = {text for entry in book.entries for texts in entry.texts.values() for text in texts}
    asides = [choose_alternatives(text, rng) for texts in book.asides.values() for text in texts]
    assert not phrasings & set(asides)
    plain = [text.lower() for text in asides]
    assert any(caption.request and any(text in caption.text.lower() for text in plain) for caption in captions)


def test_a_count_that_is_corrected_asks_for_the_last_number():
    rng = np.random.default_rng(0)
    repairs = phrasebook("en").style["repairs"]
    texts = [compose_freely(rng, language="en", style="numbers") for _ in range(300)]
    corrected = [caption for caption in texts if any(repair in caption.text for repair in repairs)]
    ends = [next(one.text.split(repair)[1] for repair in repairs if repair in one.text) for one in corrected]
    numbers_of = [[value for *_, value in find_numbers(text)] for text in ends]  # none of "a pair of cars"
    assert sum(map(bool, numbers_of)) >= 4
    for caption, numbers in zip(corrected, numbers_of, strict=True):
        counts = [bounds for name, bounds in caption.request.items() if ATTRIBUTES[name].kind == "range"]
        within = [low <= number <= (number if high is None else high) for low, high in counts for number in numbers]
        assert any(within) or not numbers


def test_phrasings_are_many_and_distinct():
    templates = [(code, text) for code in languages() for text in phrasebook(code).templates]
    assert len(templates) >= 2000
    assert [pair for pair, count in collections.Counter(templates).items() if count > 1] == []


def test_english_words_every_attribute_and_value():
    entries = phrasebook("en").entries
    assert {name for entry in entries for name in entry.names} == set(ATTRIBUTES)
    stated = collections.defaultdict(set)
    for entry in entries:
        for name, value in entry.values.items():
            stated[name].update(value if ATTRIBUTES[name].kind == "set" else [value])
    wordless = {
        (name, value)
        for name, attribute in ATTRIBUTES.items()
        for value in (attribute.values or ((True, False) if attribute.kind == "flag" else ()))
        if value not in stated[name] and name not in ("not_layout", "where", "compare")
    }
    assert wordless == set()
    assert set(LAYOUTS) - stated["not_layout"] == {"intersection", "no-intersection"}


def _filled(book, entry, template, register, rng):
    """A template with quantities of random kinds; None where it cannot state them."""
    units = tuple(book.words["units"])
    kinds = [kind for kind in entry.kinds if kind in book.words["quantities"]]
    number = int(rng.choice([1, 2, 3, 5, 12]))
    quantities = {
        slot: draw_distance(str(rng.choice(entry.kinds)), 20.0, units, rng)
        if SLOTS[slot] == "distance"
        else draw_quantity("exactly" if SLOTS[slot] != "count" else str(rng.choice(kinds)), number, rng)
        for slot in entry.slots
    }
    if None in quantities.values() or not usable_templates(book, [template], quantities):
        return None
    voice = str(rng.choice(list(book.words["voices"])))
    return fill(book, template, quantities, rng, register=register, voice=voice)


@pytest.mark.parametrize("code", languages())
def test_templates_can_be_filled(code):
    """Without a slot or bracket left."""
    book, rng = phrasebook(code), np.random.default_rng(0)
    for entry in book.entries:
        for register, templates in entry.texts.items():
            for template in templates:
                tries = (_filled(book, entry, template, register, rng) for _ in range(200))
                text = next(text for text in tries if text is not None)
                assert text.strip() and not set("{}[]|#~") & set(text.replace("~ ", "").replace("~", "", 1)), template


@pytest.mark.parametrize("code", languages())
def test_quantities_have_words(code):
    """Every kind with every noun, in words and digits."""
    book, rng = phrasebook(code), np.random.default_rng(0)
    for kind, noun, register in itertools.product(book.words["quantities"], book.nouns, ("said", "key")):
        kind = kind.partition(" ")[0]
        quantity = draw_quantity(kind, 3, rng) or draw_quantity(kind, 7, rng) or draw_quantity(kind, 11, rng)
        if quantity is not None:
            text = fill(book, f"{{n {noun}}}", {"n": quantity}, rng, register=register, voice="first")
            assert text.strip() and "#" not in text


@pytest.mark.parametrize("code", languages())
def test_number_words_are_distinct(code):
    book = phrasebook(code)
    genders = {noun.gender for nouns in book.nouns.values() for noun in nouns}
    for gender in genders:
        words = [number_text(book, number, gender, in_digits=False) for number in range(1, 21)]
        assert len(set(words)) == 20 and not any(word.isascii() and word.isdigit() for word in words)


@settings(max_examples=200, deadline=None)
@given(kind=st.sampled_from(KINDS), value=st.integers(0, 60), seed=SEEDS)
def test_quantities_hold_for_their_value(kind, value, seed):
    quantity = draw_quantity(kind, value, np.random.default_rng(seed))
    assert quantity is None or quantity.holds(value)
    if kind == "exactly" and value:
        assert quantity is not None and quantity.bounds == (value, value) and quantity.numbers == (value,)


@settings(max_examples=200, deadline=None)
@given(
    kind=st.sampled_from(["exact", "at_least", "at_most"]),
    value=st.none() | st.floats(0.0, 60.0),
    seed=SEEDS,
)
def test_distances_hold_for_their_value(kind, value, seed):
    distance = draw_distance(kind, value, tuple(UNITS), np.random.default_rng(seed))
    if distance is not None:
        assert distance.bounds[1] is None if value is None else distance.holds(value)


@settings(max_examples=200, deadline=None)
@given(seed=SEEDS)
def test_typing_errors_leave_numbers_alone(seed):
    rng = np.random.default_rng(seed)
    text = "exactly twelve vehicles ahead, three behind, 15 pedestrians, 2, 3 lanes"
    typed = add_typing_errors(text, phrasebook("en"), 3, rng)
    for word in ("twelve", "three", "15", "2, 3"):
        assert word in drop_punctuation(typed)


def test_same_seed_gives_the_same_text():
    _, measured = analyses()[0]
    assert compose(measured, np.random.default_rng(5)) == compose(measured, np.random.default_rng(5))


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"style": "poetry"}, "no style 'poetry': choose from terse"),
        ({"language": "xx"}, "no phrasings in 'xx': choose from en"),
        ({"style": "languages", "language": "en"}, "choose another style for English"),
    ],
)
def test_unknown_styles_and_languages_are_refused(options, fault):
    with pytest.raises(ValueError, match=fault):
        compose_freely(np.random.default_rng(0), **options)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ('asks = { nothing = 1 }\nsaid = ["x"]', "no attribute 'nothing'"),
        ('asks = { ahead = "q" }\nsaid = ["x"]', "ahead = 'q': write a range"),
        ('asks = { ahead = "n" }\nshout = ["x"]', "unknown fields shout"),
        ('asks = { ahead = "n" }\nkinds = ["lots"]\nsaid = ["x"]', "kinds lots"),
        ("asks = { ahead = 1 }", "asks or texts are missing"),
        ("asks = [", "is no TOML"),
    ],
)
def test_faults_of_phrasing_files_are_named(tmp_path, monkeypatch, content, fault):
    (tmp_path / "en").mkdir()
    source = phrasebook_module.FOLDER / "en"
    for name in ("words.toml", "style.toml"):
        (tmp_path / "en" / name).write_bytes((source / name).read_bytes())
    (tmp_path / "en" / "road.toml").write_text(f"[[phrase]]\n{content}\n")
    monkeypatch.setattr(phrasebook_module, "FOLDER", tmp_path)
    monkeypatch.setattr(phrasebook_module, "languages", lambda: ("en",))
    with pytest.raises(ValueError, match=fault):
        phrasebook.__wrapped__("en")


def test_package_holds_the_phrasings():
    package = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["scjax"]
    shipped = {path for pattern in package for path in (ROOT / "scjax").glob(pattern)}
    assert set(phrasebook_module.FOLDER.rglob("*.toml")) <= shipped


def test_page_follows_from_the_grammar():
    page = (ROOT / "docs/captions.md").read_text(encoding="utf-8")
    assert page == captions_page(), "run python -m scjax.language.grammar.page docs/captions.md"


def _plain(text):
    """Letters and digits of a text, in lower case."""
    return "".join(letter for letter in text.lower() if letter.isalnum())


@pytest.fixture(scope="module")
def people_prompts():
    """Prompts as people type them, which nothing may copy."""
    shared = os.environ.get("SCJAX_SHARED", ROOT.parent / "shared")
    path = Path(shared) / "prompts/dev.jsonl"
    if not path.is_file():
        pytest.skip(f"{path} is not there: set SCJAX_SHARED to compare with the prompts of people")
    return {_plain(json.loads(line)["prompt"]) for line in path.read_text(encoding="utf-8").splitlines()}


def test_no_phrasing_is_a_prompt_of_people(people_prompts):
    texts = [text for code in languages() for text in phrasebook(code).templates]
    texts += [one.text for one in written_prompts()]
    assert [text for text in texts if _plain(text) in people_prompts] == []


def test_no_composition_is_a_prompt_of_people(people_prompts):
    rng = np.random.default_rng(0)
    texts = [compose_freely(rng).text for _ in range(400)]
    assert [text for text in texts if _plain(text) in people_prompts] == []
    assert len(set(texts)) > 360
