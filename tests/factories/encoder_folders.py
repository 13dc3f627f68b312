"""Small random text encoders in the layout of Hugging Face."""

from __future__ import annotations

import json

import jax
import numpy as np
import safetensors.numpy
from tokenizers import Tokenizer, models, pre_tokenizers

from scjax.encoders import bert
from scjax.encoders.base import pure_functions
from scjax.encoders.text import NETWORKS
from scjax.nn.state_dict import export

WORDS = ["[PAD]", "[UNK]", *"a road with two lanes and three cars that bend left".split()]
CONFIG = bert.BertConfig(
    vocab_size=len(WORDS),
    hidden_size=16,
    num_hidden_layers=2,
    num_attention_heads=2,
    intermediate_size=24,
    max_position_embeddings=40,
)


def write_encoder(folder, config=CONFIG, kind="bert", prefix=""):
    """A random encoder in the layout of Hugging Face."""
    folder.mkdir(parents=True, exist_ok=True)
    network = NETWORKS[kind]
    state = export(pure_functions(network, config).init(jax.random.key(3)), network.weight_rules(config))
    state = {prefix + name: np.ascontiguousarray(value) for name, value in state.items()}
    safetensors.numpy.save_file(state, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps({"model_type": kind, **config.__dict__}))
    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(WORDS)}, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.save(str(folder / "tokenizer.json"))
    return folder
