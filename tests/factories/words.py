"""A text encoder without weights: every word is a token."""

from __future__ import annotations

import numpy as np

from scjax.encoders import TokenFeatures


class Words:
    """An encoder whose token features are drawn from the letters of each word."""

    name, width = "words-1", 5

    def __init__(self):
        self.calls = []

    def __call__(self, texts):
        self.calls += texts
        return [TokenFeatures(self.features(text), tuple(text.split())) for text in texts]

    def is_cut(self, text):
        return len(text.split()) > 50

    @classmethod
    def features(cls, text):
        """[words, width] features of a text."""
        return np.stack([cls.word(word) for word in text.split()])

    @classmethod
    def word(cls, word):
        return np.random.default_rng(list(word.encode())).normal(size=cls.width).astype(np.float32)
