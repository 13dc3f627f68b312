"""Texts of conditions as streams: prompts, and texts made of attributes for models that read text alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from scjax.encoders.base import TextEncoder
from scjax.encoders.text import load_text_encoder
from scjax.generate.conditions import Condition, Stream
from scjax.generate.model import Model
from scjax.generate.readings import reads_requests
from scjax.language.attributes.request_text import request_text


def text_streams(
    conditions: Sequence[Condition], model: Model, encoder: TextEncoder | None = None
) -> list[Mapping[str, Stream]]:
    """The streams "text" and "negative_text" of every condition; each different text is encoded once.

    Args:
      encoder: the text encoder; by default the one that ``load_text_encoder`` finds. It is needed only for texts that
        are not among ``model.prompts``.

    Raises:
      ValueError: the model reads no text, or the encoder is not the model's.
    """
    by_condition = [_texts(condition, model) for condition in conditions]
    texts = dict.fromkeys(text for one in by_condition for text in one.values())
    features = _encode_texts(list(texts), model, encoder) if texts else {}
    return [{name: Stream(features[text]) for name, text in own.items()} for own in by_condition]


def _texts(condition: Condition, model: Model) -> dict[str, str]:
    """Stream name -> the text that fills it.

    Attributes become a text for a model that reads text alone; there they take the place of a prompt that the model
    does not read itself. A model that reads neither leaves them to the choice among candidates.
    """
    texts = condition.prompts
    if not model.text_encoder:
        return {} if reads_requests(model) else texts
    if model.denoiser.config.attributes:
        return texts
    requests = {"text": condition.attributes, "negative_text": condition.negative_attributes}
    for name, request in requests.items():
        is_open = name not in texts or (model.reads_prompts and texts[name] not in model.prompts)
        if name not in condition.streams and is_open and (text := request_text(request)):
            texts = texts | {name: text}
    return texts


def _encode_texts(texts: Sequence[str], model: Model, encoder: TextEncoder | None) -> dict[str, np.ndarray]:
    """Text -> token features [tokens, width]: those stored in the model, else from the text encoder."""
    if not model.text_encoder:
        raise ValueError(
            "Condition.prompt is given, but this model was not trained on text: leave it out, or load another one"
        )
    missing = [text for text in texts if text not in model.prompts]
    if not missing:
        return dict(model.prompts)
    encoder = encoder or load_text_encoder()
    if encoder.name != model.text_encoder:
        raise ValueError(
            f"Condition.prompt needs the encoder that this model was trained with, {model.text_encoder}, but the text "
            f"encoder here is {encoder.name}: "
            "give the folder of that one by the variable SCJAX_TEXT_ENCODER"
        )
    for text in missing:
        if encoder.is_cut(text):
            warnings.warn(f"a prompt of {len(text.split())} words is too long: its end is not read", stacklevel=6)
    encoded = {text: tokens.features for text, tokens in zip(missing, encoder(missing), strict=True)}
    return {**model.prompts, **encoded}
