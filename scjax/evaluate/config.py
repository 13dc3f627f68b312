"""What an evaluation compares: python -m scjax.evaluate --config=scjax/evaluate/config.py:<variant>

standard: a model beside floor and baselines (--config.model=runs/denoiser/model --config.reference=records:R#val
--config.bank=records:R#train). baselines: the rows that need no model. placement: traffic on given lanes. prompts: what
a model that reads text makes of captions. The paper's tables: controllability, mechanisms, collisions (L_col x f_count;
a model without f_count draws counts from its table), generalisation; their rows are models, or scenes made before
(npz:).
"""

from __future__ import annotations

import ml_collections

_RETRIEVAL = ("chance", "count-matched", "nearest caption", "nearest caption + counts")
_LADDER = ("other scene, same counts", "C1", "C2", "C3", "copy")

_GAINS = (
    "prompt, true counts|another's prompt, true counts",  # SPG_prompt
    "prompt, true counts|nearest caption + counts",
    "prompt|nearest caption",
)

VARIANTS: dict[str, tuple[str, ...]] = {
    "standard": (
        "samples=model:MODEL#counts",
        "drawn=model:MODEL#drawn",
        "decoded=model:MODEL#decoded",
        *_RETRIEVAL,
        *_LADDER,
    ),
    "baselines": (*_RETRIEVAL, *_LADDER),
    "placement": (
        "on real lanes=model:MODEL#lanes",
        "own lanes=model:MODEL#counts",
        "random on lanes",
        "count-matched",
        "copy",
    ),
    "prompts": (
        "prompt=model:MODEL#prompt",
        "prompt, true counts=model:MODEL#prompt+counts",
        "another's prompt, true counts=model:MODEL#other prompt+counts",
        "no prompt, true counts=model:MODEL#counts",
        *_RETRIEVAL,
        "other scene, same counts",
        "copy",
    ),
    "controllability": (
        "unconditional, true counts=model:MODEL#counts",
        "prompt=model:MODEL#prompt",
        "image=npz:IMAGE?inorder",
        *_RETRIEVAL,
        "other scene, same counts",
        "copy",
    ),
    "mechanisms": (
        "cross-global=model:CROSS_GLOBAL#prompt",
        "windowed=model:WINDOWED#prompt",
        "global only=model:GLOBAL#prompt",
        "concatenation=model:CONCAT#prompt",
        "count-matched",
        "copy",
    ),
    "collisions": (
        "neither=model:NEITHER#prompt",
        "L_col=model:L_COL#prompt",
        "f_count=model:F_COUNT#prompt",
        "both=model:BOTH#prompt",
        "count-matched",
        "copy",
    ),
    "generalisation": (
        "prompt=model:MODEL#prompt",
        "unconditional, true counts=model:MODEL#counts",
        *_RETRIEVAL,
        "copy",
    ),
}


def get_config(variant: str = "standard") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"unknown variant {variant!r} of evaluate.py: choose one of {', '.join(VARIANTS)}")
    config = ml_collections.ConfigDict()
    config.title = variant.capitalize()
    config.reference = "records:runs/records#val"  # scenes that rows answer; records:, tiles: or npz:
    config.bank = "records:runs/records#train"  # training scenes, for retrieval, floor and novelty; "" for none
    config.model = ""  # folder that MODEL in a row stands for
    config.scenes = ("",)  # NAME=FOLDER: what other capitals in a row stand for, as IMAGE=runs/image
    config.rows = VARIANTS[variant]  # see scjax/evaluate/methods.py
    config.more = ("",)  # rows besides
    config.samples = 0  # scenes of a row; 0: as many as there are references
    config.seed = 0
    config.steps = 0  # diffusion steps; 0: all of training
    config.guidance = 0.0  # 0: the model's own
    config.temperature = (0.0, 0.0)  # of agents and of lanes; 0: the model's own
    config.consensus = 1  # samples of a condition, for AP_consensus and diversity
    # Degrees to either side of a camera, and metres that it is ahead of the ego's centre, in whose view agents are
    # compared: (50.0, 0.0) as in the paper's loss, or a camera's own (scjax.metrics.placement.camera); 0: everywhere.
    config.wedge = (0.0, 0.0)
    config.facts = True  # compare the facts of captions
    config.novelty = 0 if variant == "baselines" else 150  # scenes of a row whose nearest training scene is sought
    config.latent = ""  # folder of a model whose autoencoder judges, too; MODEL for that of --config.model
    config.compat = True  # the tables as the reference code counts, too
    config.gains = _GAINS if variant == "prompts" else ("",)  # ROW|OTHER: how much more control one shows, surely
    config.draws = 300  # of the bootstrap
    config.workers = 2  # processes that measure; 0: this one
    # (i, n): make or measure every n-th part from the i-th on. n calls on one folder, then, where a model makes scenes,
    # n more; the last to finish writes the report.
    config.shard = (0, 1)
    return config
