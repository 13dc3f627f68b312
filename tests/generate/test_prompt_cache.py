"""Token features of prompts in a file."""

from __future__ import annotations

import chex
import numpy as np

from scjax.generate.prompt_cache import load_prompts, write_prompts


def test_prompts_survive_a_round_trip(tmp_path):
    features = {"eine Straße, zwei Autos": np.ones((3, 5), np.float32)}
    write_prompts(features, "words-1", tmp_path / "prompts.safetensors")
    chex.assert_trees_all_equal(load_prompts(tmp_path / "prompts.safetensors", "words-1"), features)


def test_prompts_of_another_encoder_are_not_read(tmp_path):
    write_prompts({"a road": np.ones((3, 5), np.float32)}, "words-1", tmp_path / "prompts.safetensors")
    assert load_prompts(tmp_path / "prompts.safetensors", "words-2") == {}
    assert load_prompts(tmp_path / "nothing", "words-1") == {}
