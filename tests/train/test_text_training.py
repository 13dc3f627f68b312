"""Prompts end to end: condition blocks on captions for an unconditional base, counts; then scenes for a prompt."""

from __future__ import annotations

import dataclasses
import json
import re

import jax
import numpy as np
import pytest

import scjax
from experiments.package_model import counted, ship
from experiments.studies import gallery
from scjax.cli.demo import PROMPTS
from scjax.data.loader import batch_of
from scjax.data.manifest import load_manifest
from scjax.generate.prompt_reader import PromptReader, reader_config
from scjax.language.attributes.vector import feature_names
from scjax.language.reader.targets import Reading
from scjax.models import codec as presets
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
from scjax.nn.cross_attention.windowed import WindowedOptions
from scjax.nn.functional import flatten
from scjax.synthetic.domains import DOMAINS
from scjax.train.loop import train
from scjax.train.objectives import make_objective
from scjax.train.objectives.validation_examples import validation_examples
from tests.factories.small_runs import get_config
from tests.factories.words import Words
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory, captioned_records):
    """Captioned and embedded records, and models of both stages before text."""
    folder = tmp_path_factory.mktemp("text")
    (folder / "records").symlink_to(captioned_records)
    domains = tuple(load_manifest(captioned_records)["domains"])
    base = tiny_model(domains=len(domains))  # without position heads: the training with text fits them
    base = dataclasses.replace(base, domains=domains, counts=None)
    scjax.save(base.without("denoiser"), folder / "autoencoder")
    scjax.save(base, folder / "base")
    return folder


def configured(objective: str, folder):
    config = get_config(objective)
    config.records = str(folder / "records")
    config.steps, config.evaluate_every, config.picture_every, config.checkpoint_every = 3, 3, 0, 3
    config.batch.batch_size = 3  # on one of two devices: to spread a step takes a fifth more of its compiler
    if objective == "denoiser":
        config.autoencoder, config.model.relative_geometry = str(folder / "autoencoder"), True
    return config


@pytest.fixture(scope="module")
def text_model(folder):
    config = configured("denoiser", folder)
    config.condition, config.init_from, config.freeze = "text", str(folder / "base"), True
    config.attributes, config.evaluate_every = True, 0  # to evaluate is one more large program
    config.loss.collision, config.loss.connections, config.loss.lateral_offsets = 0.1, 0.3, 0.1
    config.cross_attention, config.cross_attention_options.windowed.window = "windowed", 4
    train(config, folder / "text")
    return scjax.load(folder / "text" / "model")


def sample(model, condition):
    """One of two scenes: several are sampled here by one program, as the gallery does."""
    return scjax.sample(0, condition, model=model, num_scenes=2, num_steps=2)[0]


@pytest.mark.parametrize("condition", ["none", "text", "image"])
def test_validation_examples_are_cut_to_the_bucket(folder, condition):
    examples = validation_examples(
        str(folder / "records"), presets.scjax(), condition=condition, bucket=(4, 6), text_slots=96
    )
    sizes = [(example.scene.agent_mask.shape[-1], example.scene.lane_mask.shape[-1]) for example in examples]
    assert max(agents for agents, _ in sizes) == 4 and max(lanes for _, lanes in sizes) == 6
    assert len(batch_of(examples, (4, 6)).scene.crop) == len(examples)


def test_freeze_keeps_the_base_parameters(folder, text_model):
    base = flatten(scjax.load(folder / "base").denoiser.params)
    text = flatten(text_model.denoiser.params)
    assert all(np.array_equal(text[path], value) for path, value in base.items())
    assert any("context" in path for path in text.keys() - base.keys())
    assert text_model.text_encoder == "words-1"
    assert text_model.denoiser.config.cross_attention == WindowedOptions(window=4)


def test_a_model_reads_text_and_attributes_together(text_model):
    """Three steps have hardly moved the new parameters, so that they are moved here."""
    assert text_model.denoiser.config.attributes == feature_names()
    params = dict(text_model.denoiser.params)
    params["attributes"] = jax.tree.map(lambda leaf: leaf + 0.3, params["attributes"])
    model = text_model.with_component("denoiser", text_model.denoiser.config, params)
    text = {"text": scjax.Stream(Words()(["a straight road"])[0].features)}

    def lanes(**request):
        condition = scjax.Condition(num_lanes=6, num_agents=3, domain=0, streams=text, attributes=request)
        return sample(model, condition).lanes

    plain, requested = lanes(), lanes(layout="T", vehicles=2)
    np.testing.assert_array_equal(lanes(vehicles=(0, None)), plain)
    assert np.abs(requested - plain).max() > 0.1


@pytest.fixture(scope="module")
def prompt_model(folder, text_model):
    config = configured("counts", folder)
    config.denoiser = str(folder / "text" / "model")
    train(config, folder / "prompt")
    return scjax.load(folder / "prompt" / "model")


def test_a_prompt_decides_counts_and_scene(prompt_model):
    model = prompt_model
    assert model.count_predictor.config.text_width == Words.width
    tokens = Words()(["a straight road"])[0].features
    scjax.validate(sample(model, scjax.Condition(streams={"text": scjax.Stream(tokens)})))


def test_counts_are_learned_from_requests_for_attributes(folder, text_model):
    config = configured("counts", folder)
    config.condition, config.denoiser = "attributes", str(folder / "text" / "model")
    train(config, folder / "requested")
    model = scjax.load(folder / "requested" / "model")
    network = model.count_predictor.config
    assert network.attributes == feature_names() and network.text_width == len(feature_names())
    condition = scjax.Condition(attributes={"layout": "straight", "vehicles": (2, None)})
    assert sample(model, condition).num_agents >= 3


def test_a_model_ships_with_what_users_need_and_nothing_of_this_machine(folder, prompt_model, tmp_path):
    out = tmp_path / "pretrained"
    out.mkdir()
    (out / "README.md").write_text("card")
    sizes = ship(prompt_model, out, Words())
    assert (out / "README.md").read_text() == "card" and sum(sizes.values()) < 1
    text = (out / "model.json").read_text()
    assert str(folder) not in text and "config" not in json.loads(text)["notes"]
    shipped = scjax.load(out)
    assert shipped.notes["steps"] == {"denoiser": 3, "count_predictor": 3}
    assert tuple(shipped.prompts) == tuple(sorted(PROMPTS))
    ship(shipped, tmp_path / "again", Words())
    assert scjax.load(tmp_path / "again").notes == shipped.notes
    exact = jax.tree.leaves((prompt_model.denoiser.params, prompt_model.count_predictor.params))
    for a, b in zip(jax.tree.leaves((shipped.denoiser.params, shipped.count_predictor.params)), exact, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-6)


def test_a_model_without_text_ships_without_an_encoder(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.package_model.load_text_encoder", None)
    names = feature_names()
    model = tiny_model(attributes=names)
    sizes = CountPredictorConfig(text_width=len(names), attributes=names, domains=2, width=8, queries=1, heads=1)
    model = model.with_component("count_predictor", sizes, count_predictor(sizes).init(jax.random.key(0)))
    domains = tuple(domain.name for domain in DOMAINS[:2])
    ship(dataclasses.replace(model, domains=domains), tmp_path / "out")
    assert not scjax.load(tmp_path / "out").prompts


def test_a_gallery_has_a_picture_a_prompt_and_says_what_is_met(text_model, tmp_path, monkeypatch):
    requests = {
        "a four-way intersection with three vehicles": {"layout": "four-way", "vehicles": (3, 3)},
        "a straight road without pedestrians": {"layout": "straight", "pedestrians": (0, 0)},
        "a kangaroo": {},
    }
    known = {text: Reading(request, dict.fromkeys(request, 0.9)) for text, request in requests.items()}
    reader, prompts = PromptReader(reader_config(8, width=16, heads=2), {}, "none", known), list(requests)
    monkeypatch.setattr("scjax.generate.readings.load_reader", lambda: reader)
    features = {text: one.features for text, one in zip(prompts, Words()(prompts), strict=True)}
    scjax.save(dataclasses.replace(text_model, prompts=features), tmp_path / "model")
    (tmp_path / "prompts.txt").write_text("\n".join(prompts))
    options = [f"--model={tmp_path / 'model'}", f"--prompts={tmp_path / 'prompts.txt'}", f"--out={tmp_path / 'out'}"]
    (tmp_path / "remarks.txt").write_text("2: the road ends in a field")
    gallery.main([*options, "--samples=2", "--best-of=2", "--num-steps=2", f"--remarks={tmp_path / 'remarks.txt'}"])
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["prompt-01.png", "prompt-02.png", "prompt-03.png"]
    text = (tmp_path / "out.md").read_text()
    assert "the best of 2, repaired" in text and all(prompt in text for prompt in prompts)
    total = sum(int(n) for n in re.findall(r"layout \| (\d) of 4", text))
    assert total == text.count("layout yes")
    assert text.index("prompt-02.png") < text.index("Seen: the road ends in a field") < text.index("prompt-03.png")
    assert text.count("- warning: ") == 1 and "is understood of 'a kangaroo'" in text

    gallery.main([*options[:2], f"--out={tmp_path / 'numbers'}", "--samples=1", "--num-steps=2", "--numbers-only"])
    text = (tmp_path / "numbers.md").read_text()
    assert "- warning: the warning quotes the prompt" in text and not any(prompt in text for prompt in prompts)


def test_a_remark_without_a_number_is_refused(tmp_path):
    (tmp_path / "remarks.txt").write_text("1: a road\nnothing")
    with pytest.raises(ValueError, match="line 2"):
        gallery.read_remarks(tmp_path / "remarks.txt")


def test_prompts_are_read_from_lines_and_from_all_lists_of_a_json_file(tmp_path):
    lists = {
        "one": [{"prompt": "a road", "images": ["1.jpg"]}, {"prompt": " "}],
        "two": ["a T-intersection"],
        "three": [{"type": "image", "condition": "1.jpg"}, {"type": "text", "condition": "a bend"}],
    }
    for name, content in (("p.json", json.dumps(lists)), ("p.txt", "a road\n\na T-intersection\n a bend\n")):
        (tmp_path / name).write_text(content)
        assert gallery.read_prompts(tmp_path / name) == ["a road", "a T-intersection", "a bend"]
    for name, content in (("none.json", "{}"), ("none.txt", "\n"), ("bad.json", "{")):
        (tmp_path / name).write_text(content)
        with pytest.raises(ValueError, match=name):
            gallery.read_prompts(tmp_path / name)


def test_counts_of_another_training_may_ship_if_they_read_the_same(prompt_model, text_model, tmp_path):
    without = prompt_model.without("count_predictor")
    assert counted(without, prompt_model).count_predictor is prompt_model.count_predictor
    another = dataclasses.replace(prompt_model, text_encoder="another")
    with pytest.raises(ValueError, match="do not fit"):
        counted(without, another)
    fields = {"attributes": feature_names(), "text_width": len(feature_names())}
    sizes = dataclasses.replace(another.count_predictor.config, **fields)
    requested = another.with_component("count_predictor", sizes, another.count_predictor.params)
    assert counted(without, requested).count_predictor is requested.count_predictor


def test_a_model_of_recordings_or_without_a_part_does_not_ship(prompt_model, tmp_path):
    with pytest.raises(ValueError, match="only the synthetic world may ship"):
        ship(dataclasses.replace(prompt_model, domains=("city", "nuplan")), tmp_path / "a", Words())
    with pytest.raises(ValueError, match="no count_predictor"):
        ship(prompt_model.without("count_predictor"), tmp_path / "a", Words())
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"freeze": True}, r"name its folder in config\.init_from"),
        ({"condition": "smell"}, 'choose "none", "text" or "image"'),
        ({"cross_attention": "windowd"}, "did you mean 'windowed'"),
    ],
)
def test_denoiser_objective_rejects_bad_options(folder, fields, message):
    config = configured("denoiser", folder)
    config.update(fields)
    with pytest.raises(ValueError, match=message):
        make_objective(config)


def test_denoiser_objective_needs_a_base_with_a_denoiser(folder):
    config = configured("denoiser", folder)
    config.init_from = str(folder / "autoencoder")
    with pytest.raises(ValueError, match="holds no denoiser"):
        make_objective(config)


def test_count_objective_needs_a_text_model(folder):
    config = configured("counts", folder)
    config.denoiser = str(folder / "base")
    with pytest.raises(ValueError, match="was trained on no text"):
        make_objective(config)


def test_make_objective_names_the_known_objectives(folder):
    config = configured("counts", folder)
    config.objective = "speech"
    with pytest.raises(ValueError, match="choose one of autoencoder, denoiser, counts"):
        make_objective(config)
