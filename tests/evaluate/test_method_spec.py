"""Methods from config entries and command-line text; what is refused, and with which cure."""

import pytest

from scjax.evaluate.config import VARIANTS, get_config
from scjax.evaluate.method_spec import MethodSpec, parse_method, parse_methods


def test_parse_method_reads_dicts_and_text_alike():
    text = "name=prompt, true counts, model=runs/a b, request=prompt+counts, best_of=8, energy_guidance=false"
    entry = {
        "name": "prompt, true counts",
        "model": "runs/a b",
        "request": "prompt+counts",
        "best_of": 8,
        "energy_guidance": False,
    }
    assert parse_method(text) == parse_method(entry) == MethodSpec(**entry)


def test_parse_method_reads_names_of_baselines():
    assert parse_method("nearest caption + counts").baseline == "nearest caption + counts"


def test_parse_methods_adds_the_text_of_the_command_line():
    specs = parse_methods(("copy",), "name=a, source=npz:x; name=b, source=npz:y, pairing=in_order; chance")
    assert [spec.name for spec in specs] == ["copy", "a", "b", "chance"]
    assert [spec.answers_references for spec in specs] == [True, False, True, True]


def test_title_names_a_selection():
    spec = parse_method("name=prompt, model=m, request=prompt, best_of=8")
    assert spec.title == "prompt (best of 8, repaired)"


def test_with_folders_fills_names_in_braces():
    spec = parse_method({"name": "a", "source": "npz:{image}", "pairing": "in_order"})
    assert spec.with_folders({"image": "runs/x"}).source == "npz:runs/x"
    with pytest.raises(ValueError, match=r"\{image\} has no folder: give --config.folders.image=FOLDER"):
        spec.with_folders({})


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_parses(variant):
    config = get_config(variant)
    folders = {**dict.fromkeys(config.folders, "x"), "model": "m"}
    specs = [spec.with_folders(folders) for spec in parse_methods(config.methods, config.more)]
    assert len({spec.title for spec in specs}) == len(config.methods)


def test_get_config_rejects_unknown_variants():
    with pytest.raises(ValueError, match=r"unknown variant 'huge'.* choose one of standard, baselines"):
        get_config("huge")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("luck", r"method 'luck': write name=..., source=... .*or one of the baselines chance"),
        ("model=m, request=prompt", "a method needs a name"),
        ({"name": "a", "baseline": "luck"}, "baseline must be one of chance, .*, not 'luck'"),
        ("name=a", "exactly one of source=, model= and baseline="),
        (
            "name=a, model=m, request=luck",
            r"request must be one of counts, lanes, prompt, prompt\+counts, .*not 'luck'",
        ),
        ("name=a, source=npz:x, pairing=luck", "pairing, of a source, must be one of in_order, chance"),
        ("name=a, source=npz:x, request=prompt", "request apply to a model"),
        ({"name": "a", "colour": "red"}, "unknown field 'colour': choose among name, source"),
        ("name=a, model=m, request=prompt, best_of=many", "best_of must be a whole number, not 'many'"),
        ("name=a, model=m, request=prompt, best_of=0", "best_of must be at least 1"),
        ("name=a, model=m, request=prompt, energy_guidance=luck", "energy_guidance must be true or false"),
        ("name=a, model=m, request=reconstruction, energy_guidance=true", "reconstructions are not sampled"),
        ("name=a, model=m, request=counts, best_of=8", "selects by the prompt, and the request 'counts' has none"),
    ],
)
def test_parse_method_names_the_fault(entry, message):
    with pytest.raises(ValueError, match=message):
        parse_method(entry)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("a=model:m#counts", "name=a, model=m, request=counts"),
        ("a=model:m#drawn?unsteered", "name=a, model=m, request=none, energy_guidance=false"),
        ("a=model:m#other prompt+counts", r"name=a, model=m, request=shuffled_prompt\+counts"),
        ("a=model:m#prompt?picked", "name=a, model=m, request=prompt, best_of=8"),
        ("a=npz:x?inorder", "name=a, source=npz:x, pairing=in_order"),
        ("a=records:x#val?chance", "name=a, source=records:x#val, pairing=chance"),
        ("a=npz:x", "name=a, source=npz:x"),
    ],
)
def test_parse_method_answers_the_old_form_with_the_new(old, new):
    with pytest.raises(ValueError, match=f"earlier version: write '{new}'"):
        parse_method(old)
