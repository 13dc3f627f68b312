"""Do scenes show what their prompts ask for? One row a source of scenes, one column an attribute.

    python -m experiments.studies.prompt_adherence --model=runs/prompt/model --records=runs/synthetic --out=runs/adherence

Prompts are captions of held-back records; what each asks for and what each scene shows are read by rule
(scjax.language). Rows: the model at several guidance weights, also at true counts, or as the best of several
tidied candidates (chosen by the same rules, so no independent judgement); if it is steered, without steering at true
counts; without prompts at true counts; the
training scene whose caption is nearest; and the record itself (what the rules miss: the ceiling). A second table tells
how sound the scenes are; those of one candidate are judged as they were sampled and after ``scjax.scene.repair``. Where records
have labels, the agreement of the rules with them is printed below.
"""

from __future__ import annotations

import dataclasses
import gzip
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.arguments import parser_of
from scjax.data import records
from scjax.data.caption_features import TextStore
from scjax.data.captions import Caption, read_captions
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.samplers import SAMPLERS
from scjax.encoders.text import clean_text
from scjax.evaluate.retrieval import tf_idf
from scjax.language.agreement import label_agreement
from scjax.language.captioner import STYLES
from scjax.language.facts import Facts, extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from scjax.metrics.realism import realism
from scjax.nn.startup import start_jax
from scjax.scene import Scene
from scjax.scene.files import write_text

Scores = dict[str, tuple[int, int]]
SOUND = {
    "connection_gap_m": "mean gap of links [m]",
    "open_connections": "links open by > 1 m",
    "vehicles_on_lane": "vehicles within 1.5 m of a lane",
    "scenes_vehicle_overlap": "scenes with overlapping vehicles",
    "scenes_any_overlap": "scenes with any overlap",
}

_CALL = 32  # prompts a call of the sampler


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("adherence", __doc__)
    add = parser.add_argument
    add("--model", required=True, dest="model_folder", metavar="DIR", help="model folder")
    add("--records", required=True, dest="folder", metavar="DIR", help="captioned and embedded records")
    add("--samples", type=int, default=500, help="prompts at most (default %(default)s)")
    add("--each", type=int, metavar="N", help="only prompts of rare events, N of each at most (default: any prompt)")
    add(
        "--guidance",
        type=float,
        nargs="+",
        default=[DEFAULT_GUIDANCE_SCALE],
        dest="weights",
        metavar="W",
        help="weights (default %(default)s)",
    )
    add("--sampler", choices=SAMPLERS, help="default: the model's own")
    add("--steps", type=int, help="sampling steps (default: the sampler's own)")
    add(
        "--best",
        type=int,
        default=0,
        dest="candidates",
        metavar="K",
        help="a row of the best of K candidates a prompt (default: none)",
    )
    add("--seed", type=int, default=0)
    add("--out", type=Path, default=Path("adherence"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    options = vars(args)
    out = options.pop("out")
    try:
        table, sound, ceiling = measure(**options)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.prompt_adherence: {error}")
    content = {"rows": table, "realism": sound, "labels": ceiling}
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out.with_suffix(".json"), json.dumps(content, indent=1))
    text = markdown(table, sound, ceiling)
    write_text(out.with_suffix(".md"), text)
    print(text)


def measure(
    *,
    model_folder: str,
    folder: str,
    samples: int,
    weights: Sequence[float],
    sampler: str | None = None,
    steps: int | None = None,
    candidates: int = 0,
    seed: int = 0,
    each: int | None = None,
) -> tuple[dict[str, Scores], dict[str, dict[str, float]], Scores]:
    """Row -> attribute -> (met, asked for); row -> values of ``SOUND``; attribute -> (rules agree, labelled)."""
    model = scjax.load(model_folder)
    chosen = list(held_back_prompts(folder, model, samples, seed, each))
    asked, told, prompts = ([getattr(one, name) for one in chosen] for name in ("asked", "told", "text"))
    real = [one.scene for one in chosen]
    counts = [{"num_lanes": int(scene.num_lanes), "num_agents": int(scene.num_agents)} for scene in real]
    both = [dataclasses.replace(one, **count) for one, count in zip(told, counts, strict=True)]
    runs = {f"prompt, guidance {weight:g}": (told, weight, None) for weight in weights}
    runs[f"prompt and true counts, guidance {weights[0]:g}"] = both, weights[0], None
    if model.energy_guidance is not None:
        runs[f"prompt and true counts, guidance {weights[0]:g}, not steered"] = both, weights[0], False
    runs["no prompt, true counts"] = [scjax.Condition(**count) for count in counts], 1.0, None
    table: dict[str, Scores] = {}
    sound: dict[str, dict[str, float]] = {}
    for title, (conditions, weight, energy_guidance) in runs.items():
        made = sampled(
            conditions,
            title,
            seed,
            model=model,
            sampler=sampler,
            num_steps=steps,
            guidance=weight,
            energy_guidance=energy_guidance,
        )
        tidied = [scjax.repair(scene) for scene in made]
        for name, scenes in ((title, made), (f"{title}, tidied", tidied)):
            table[name], sound[name] = scores(zip(asked, map(extract_facts, scenes), strict=True)), realism(scenes)
    if candidates > 1:  # as the command line
        title = f"prompt, guidance {weights[0]:g}, best of {candidates} tidied"
        made = []
        for start in tqdm(range(0, len(told), _CALL), title, disable=None):
            part = slice(start, start + _CALL)
            made += scjax.sample(
                jax.random.fold_in(jax.random.key(seed), start),
                [scjax.Condition(prompt=prompt) for prompt in prompts[part]],
                model=dataclasses.replace(model, prompts={**model.prompts, **_features(prompts[part], told[part])}),
                num_steps=steps,
                guidance=weights[0],
                sampler=sampler,
                best_of=candidates,
                repair=True,
            )
        table[title], sound[title] = scores(zip(asked, map(extract_facts, made), strict=True)), realism(made)
    table["training scene of the nearest caption"] = scores(zip(asked, _nearest(folder, prompts), strict=True))
    table["the record itself"] = scores((one.asked, one.facts) for one in chosen)
    sound["the record itself"] = realism(real)
    return table, sound, folder_label_agreement(folder)


def held_back(folder: str, model: scjax.Model) -> tuple[list[Caption], TextStore]:
    """Captions of the held-back records, and their token features.

    Raises:
      ValueError: they are embedded by another encoder than the model's.
    """
    captions, store = list(read_captions(folder, "val")), TextStore(folder, "val")
    if store.encoder != model.text_encoder:
        raise ValueError(f"{folder} is embedded by {store.encoder}, the model was trained with {model.text_encoder}")
    return captions, store


class Prompted(NamedTuple):
    """A held-back record: a caption of it, what that asks for, its token features; the scene and its facts."""

    text: str
    asked: PromptSpec
    told: scjax.Condition
    scene: Scene
    facts: Facts


def held_back_prompts(
    folder: str, model: scjax.Model, samples: int, seed: int, each: int | None = None
) -> Iterator[Prompted]:
    """So many held-back records in an order drawn from ``seed``, each with a caption in a style that is drawn.

    Args:
      each: only captions that name a rare event of which there are fewer yet; None: any caption.

    Raises:
      ValueError: as ``held_back``, or no caption names an event.
    """
    captions, store = held_back(folder, model)
    rng, tiles = np.random.default_rng(seed), records.open_records(folder, "val")
    left, events = samples, Counter()
    for row in map(int, rng.permutation(len(captions))):
        if not left:
            return
        text, tokens = a_prompt(store, captions[row], row, rng)
        asked = parse_prompt(text)
        if each is not None and not any(events[event] < each for event in asked.events):
            continue
        events.update(asked.events)
        left -= 1
        scene = model.codec.select(records.sample_scene(records.decode_record(tiles[row])))
        told = scjax.Condition(streams={"text": scjax.Stream(tokens)})
        yield Prompted(text, asked, told, scene, captions[row].facts)
    if each is not None and not events:
        raise ValueError(
            f"--each: no held-back caption of {folder} names a rare event: make records with --ordinary 0.1"
        )


def sampled(conditions: Sequence[scjax.Condition], title: str, seed: int, **options: Any) -> list[Scene]:
    """A scene a condition, some at a time under a progress bar; ``options`` are those of ``scjax.sample``."""
    made = []
    for start in tqdm(range(0, len(conditions), _CALL), title, disable=None):
        key = jax.random.fold_in(jax.random.key(seed), start)
        made += scjax.sample(key, conditions[start : start + _CALL], **options)
    return made


def _features(prompts: Sequence[str], conditions: Sequence[scjax.Condition]) -> dict[str, np.ndarray]:
    """Text -> token features, as a model stores those of its own prompts."""
    tokens = (np.asarray(condition.streams["text"].tokens) for condition in conditions)
    return {clean_text(prompt): features for prompt, features in zip(prompts, tokens, strict=True)}


def a_prompt(store: TextStore, caption: Caption, row: int, rng: np.random.Generator) -> tuple[str, np.ndarray]:
    """The first caption of a record in a style that is drawn, and its token features."""
    texts = _all(caption.texts)
    number = int(rng.integers(len(STYLES))) * (len(texts) // len(STYLES))
    return texts[number], np.asarray(store.features(int(store.texts_of(row)[number])), np.float32)


def scores(pairs: Iterable[tuple[PromptSpec, Facts]]) -> Scores:
    """Attribute -> (met, asked for)."""
    hits, total = Counter(), Counter()
    for asked, facts in pairs:
        for name, good in check(asked, facts).items():
            hits[name] += good
            total[name] += 1
    return {name: (hits[name], total[name]) for name in sorted(total)}


def folder_label_agreement(folder: str) -> Scores:
    """``label_agreement`` on the held-back records; nothing without labels."""
    path = Path(folder) / "val-labels.jsonl.gz"
    if not path.is_file():
        return {}
    with gzip.open(path, "rt") as file:
        facts = (caption.facts for caption in read_captions(folder, "val"))
        return label_agreement(zip(map(json.loads, file), facts, strict=True))


def markdown(table: dict[str, Scores], sound: dict[str, dict[str, float]], ceiling: Scores) -> str:
    """Rows and columns in percent, with how often each attribute was asked for; then how sound the scenes are."""
    names = sorted({name for row in table.values() for name in row})
    lines = ["| scenes | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for row, found in table.items():
        cells = (f"{100 * found[n][0] / found[n][1]:.0f} % of {found[n][1]}" if n in found else "" for n in names)
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    lines += ["", "| scenes | " + " | ".join(SOUND.values()) + " |", "|---" * (len(SOUND) + 1) + "|"]
    for row, found in sound.items():
        cells = (f"{found[n]:.2f}" if n.endswith("_m") else f"{100 * found[n]:.0f} %" for n in SOUND)
        cells = ("" if "nan" in cell else cell for cell in cells)  # nothing there to measure
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    if ceiling:
        told = ", ".join(f"{name} {100 * good / total:.1f} % of {total}" for name, (good, total) in ceiling.items())
        lines += ["", f"The rules agree with the labels of the synthetic world: {told}."]
    return "\n".join(lines) + "\n"


def _nearest(folder: str, prompts: Sequence[str]) -> list[Facts]:
    """Facts of the training record whose caption is most like each prompt, as the evaluation's baselines find it."""
    bank = [(text, caption.facts) for caption in read_captions(folder, "train") for text in _all(caption.texts)]
    known, wanted = tf_idf([text for text, _ in bank], prompts)
    return [bank[int((known @ wanted[[row]].T).toarray()[:, 0].argmax())][1] for row in range(len(prompts))]


def _all(texts: dict[str, list[str]]) -> list[str]:
    return [text for style in texts.values() for text in style]


if __name__ == "__main__":
    start_jax()
    main()
