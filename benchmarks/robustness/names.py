"""What the areas call, by one name, in the present code and in the old one (commit f19532b)."""

from __future__ import annotations

import importlib
from typing import Any

from benchmarks.robustness.case import Unavailable

NAMES = {  # name -> places, "module:attribute", the newest first
    "load_npz": ("scjax.scene.io:load_npz", "scjax.scene_io:load_npz"),
    "save_npz": ("scjax.scene.io:save_npz", "scjax.scene_io:save_npz"),
    "load_json": ("scjax.scene.io:load_json", "scjax.scene_io:load_json"),
    "save_json": ("scjax.scene.io:save_json", "scjax.scene_io:save_json"),
    "validate": ("scjax.scene:validate",),
    "stack": ("scjax.scene:stack",),
    "permute": ("scjax.scene:permute",),
    "Crop": ("scjax.scene:Crop", "scjax.scene:Layout"),
    "load_log": ("scjax.scene.log_io:load_log",),
    "save_log": ("scjax.scene.log_io:save_log",),
    "read_recorded": ("scjax.data.readers.scene_json:read_log", "scjax.data.scene_json:read_scene"),
    "decode_record": ("scjax.data.records:decode_record", "scjax.data.records:decode"),
    "sample_scene": ("scjax.data.records:sample_scene",),
    "open_records": ("scjax.data.records:open_records", "scjax.data.records:source"),
    "load_manifest": ("scjax.data.build:load_manifest",),
    "build_records": ("scjax.data.build:build_records", "scjax.data.build:build"),
    "BuildOptions": ("scjax.data.build_options:BuildOptions", "scjax.data.sources:BuildOptions"),
    "Worlds": ("scjax.synthetic.source:Worlds", "scjax.data.synthetic.source:Worlds"),
    "add_captions": ("scjax.data.captions:add_captions", "scjax.data.captions.store:add_captions"),
    "read_captions": ("scjax.data.captions:read_captions", "scjax.data.captions.store:read_captions"),
    "embed_captions": ("scjax.data.caption_features:embed_captions", "scjax.data.captions.embeddings:embed_captions"),
    "TextStore": ("scjax.data.caption_features:TextStore", "scjax.data.captions.embeddings:TextStore"),
    "measure_records": ("scjax.data.measurements:measure_records",),
    "MeasuredRecords": ("scjax.data.measurements:MeasuredRecords",),
    "load_text_encoder": ("scjax.encoders.text:load_text_encoder",),
    "prompt_warnings": (
        "scjax.generate.readings:prompt_warnings",
        "scjax.generate.best_of:prompt_warnings",
        "scjax.prompts:doubts",
    ),
    "clean_text": ("scjax.encoders.text:clean_text", "scjax.encoders.text:checked"),
    "Condition": ("scjax:Condition",),
    "Stream": ("scjax:Stream",),
    "sample": ("scjax:sample",),
    "load_model": ("scjax:load",),
    "save_model": ("scjax:save",),
    "Guidance": ("scjax:Guidance",),
    "PerType": ("scjax.scene.per_type:PerType", "scjax.models.nodes:Nodes"),
    "TextCondition": ("scjax.models.denoiser.config:TextCondition",),
    "ImageCondition": ("scjax.models.denoiser.config:ImageCondition",),
    "convert": ("scjax.convert.__main__:main",),
    "Checkpoints": ("scjax.train.checkpoint:Checkpoints", "experiments.checkpoint:Checkpoints"),
    "training_batches": ("scjax.data.loader:training_batches", "scjax.data.pipeline:training_batches"),
    "start_jax": ("scjax.nn.startup:start_jax", "scjax.cli.start:start_jax"),
    "tiny_model": ("tests.factories.worlds:tiny_model", "tests.worlds:tiny_model"),
    "example_scene": ("tests.factories.examples:example_scene", "tests.examples:example_scene"),
    "scene_content": ("tests.factories.scene_files:scene_content", "tests.data.raw_scenes:content"),
    "example_log": ("tests.factories.logs:example_log",),
    "small_config": ("tests.factories.small_runs:get_config", "tests.experiments.smallest:get_config"),
    "write_encoder": ("tests.encoders.test_text:write_encoder",),
    "TokenFeatures": ("scjax.encoders:TokenFeatures", "scjax.encoders.text:Tokens"),
}

OLD_ARGUMENTS = {"num_scenes": "n", "num_steps": "steps", "energy_guidance": "steering"}
OLD_FIELDS = {"crop": "layout"}


def get(name: str) -> Any:
    """What ``name`` stands for in the code under test.

    Raises:
      Unavailable: if it has nothing of the kind.
    """
    for place in NAMES[name]:
        module, _, attribute = place.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError):
            continue
    raise Unavailable(f"this code has no {name} ({' or '.join(NAMES[name])})")


def is_old() -> bool:
    """Whether the code under test is the one before the new structure."""
    try:
        importlib.import_module("scjax.scene.io")
    except ImportError:
        return True
    return False


def sample_arguments(arguments: dict[str, Any]) -> dict[str, Any]:
    """Keyword arguments of ``sample`` under the names of the code under test."""
    return {OLD_ARGUMENTS.get(name, name): value for name, value in arguments.items()} if is_old() else arguments


def condition_fields(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of ``Condition`` under the names of the code under test."""
    return {OLD_FIELDS.get(name, name): value for name, value in fields.items()} if is_old() else fields
