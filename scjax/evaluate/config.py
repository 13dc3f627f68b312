"""Variants of an evaluation: ``scjax evaluate --config=VARIANT --workdir=runs/e --config.FIELD=VALUE``.

Every variant compares its methods with the references of --config.reference. Needed besides: --config.model and
--config.retrieval_set.

standard: a model beside floor and baselines. baselines: only methods without a model. placement: traffic on given
  lanes.
prompts: what a model that reads text does with captions. The tables of the paper: controllability; mechanisms;
collisions (collision loss x count predictor; without the predictor, counts come from the model's table);
generalization. Their methods are models, or scenes on disk.

With references and retrieval set of a few hundred scenes, baselines takes about a minute on two CPU cores; a model adds
its sampling time. Of a copy, all control and match values are 1; of chance, about 0 (the global CCS: 0.976).
"""

from __future__ import annotations

from typing import Any

from ml_collections import ConfigDict

Entry = str | dict[str, Any]
"""A method: the name of a baseline, or fields of ``scjax.evaluate.method_spec.MethodSpec``."""

_RETRIEVAL: tuple[Entry, ...] = ("chance", "count-matched", "nearest caption", "nearest caption + counts")
_LADDER: tuple[Entry, ...] = ("other scene, same counts", "C1", "C2", "C3", "copy")

_GAINS = (
    ("prompt, true counts", "shuffled prompt, true counts"),  # SPG_prompt
    ("prompt, true counts", "nearest caption + counts"),
    ("prompt", "nearest caption"),
)


def _of_model(name: str, request: str, model: str = "{model}") -> Entry:
    return {"name": name, "model": model, "request": request}


_UNCONDITIONAL = _of_model("unconditional, true counts", "counts")
_PROMPT = _of_model("prompt", "prompt")

VARIANTS: dict[str, tuple[Entry, ...]] = {
    "standard": (
        _of_model("samples", "counts"),
        _of_model("unconditional", "none"),
        _of_model("reconstruction", "reconstruction"),
        *_RETRIEVAL,
        *_LADDER,
    ),
    "baselines": (*_RETRIEVAL, *_LADDER),
    "placement": (
        _of_model("on real lanes", "lanes"),
        _of_model("own lanes", "counts"),
        "random on lanes",
        "count-matched",
        "copy",
    ),
    "prompts": (
        _PROMPT,
        _of_model("prompt, true counts", "prompt+counts"),
        _of_model("shuffled prompt, true counts", "shuffled_prompt+counts"),
        _of_model("no prompt, true counts", "counts"),
        *_RETRIEVAL,
        "other scene, same counts",
        "copy",
    ),
    "controllability": (
        _UNCONDITIONAL,
        _PROMPT,
        {"name": "image", "source": "npz:{image}", "pairing": "in_order"},
        *_RETRIEVAL,
        "other scene, same counts",
        "copy",
    ),
    "mechanisms": (
        _of_model("cross-global", "prompt", "{cross_global}"),
        _of_model("windowed", "prompt", "{windowed}"),
        _of_model("global only", "prompt", "{global}"),
        _of_model("concatenation", "prompt", "{concat}"),
        "count-matched",
        "copy",
    ),
    "collisions": (
        _of_model("neither", "prompt", "{neither}"),
        _of_model("collision loss", "prompt", "{collision_loss}"),
        _of_model("count predictor", "prompt", "{count_predictor}"),
        _of_model("both", "prompt", "{both}"),
        "count-matched",
        "copy",
    ),
    "generalization": (_PROMPT, _UNCONDITIONAL, *_RETRIEVAL, "copy"),
}

_FOLDERS = {
    "controllability": ("image",),
    "mechanisms": ("cross_global", "windowed", "global", "concat"),
    "collisions": ("neither", "collision_loss", "count_predictor", "both"),
}


def get_config(variant: str = "standard") -> ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"unknown variant {variant!r} of an evaluation: choose one of {', '.join(VARIANTS)}")
    config = ConfigDict()
    config.title = variant.capitalize()

    # --- scenes: records:FOLDER#SPLIT, tiles:FILE or npz:FOLDER
    config.reference = "records:runs/records#val"  # scenes that methods answer
    config.retrieval_set = "records:runs/records#train"  # training scenes: retrieval, floor, novelty; "": none
    config.num_scenes = 0  # per method; 0: as many as references

    # --- methods
    config.methods = VARIANTS[variant]
    config.more = ""  # further methods: "name=..., model=..., request=...; name=..., source=..."
    config.model = ""  # folder for "{model}" in methods
    config.folders = ConfigDict(dict.fromkeys(_FOLDERS.get(variant, ()), ""))  # folder for other names in braces

    # --- sampling
    config.seed = 0
    config.num_steps = 0  # diffusion steps; 0: the default of the sampler
    config.guidance = 0.0  # guidance scale; 0: the model's default
    config.temperature = (0.0, 0.0)  # of agents and of lanes; 0: the model's default
    config.consensus = 1  # samples per condition, for AP_consensus and diversity

    # --- tables
    # Half angle [degrees] and distance ahead of the ego's center [m] of the camera in whose view agents are matched:
    # (50.0, 0.0) as in the paper's loss, or from scjax.metrics.placement.camera; 0: everywhere.
    config.field_of_view = (0.0, 0.0)
    config.attributes = True  # compare the attributes of scenes with those of their references
    config.novelty = (
        0 if variant == "baselines" else 150
    )  # scenes per method with a search for the nearest training scene
    config.latent_model = ""  # folder of a model whose autoencoder measures, too; "{model}": that of --config.model
    config.compat = True  # also the tables of the reference code
    config.gains = _GAINS if variant == "prompts" else ()  # (method, other): difference in control with its interval
    config.bootstrap = 300  # bootstrap samples
    config.pictures = True  # distributions, scenes side by side and galleries: most of the time of few scenes
    config.side_by_side = 12  # references in the picture that shows methods side by side
    config.gallery = 4  # best, median and worst scenes in each gallery

    # --- computation
    config.workers = 2  # processes that measure; 0: this one
    config.part_size = 250  # scenes per file of generated and measured parts
    # (i, n): generate or measure every n-th part, starting at the i-th. n calls on one folder, and n more where a model
    # generates scenes; the last one writes the report.
    config.shard = (0, 1)
    return config
