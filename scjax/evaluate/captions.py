"""The words for a reference: the same for models that are asked for it and for baselines that look for it."""

from __future__ import annotations

from scjax.language.captioner import write_caption
from scjax.language.facts import extract_facts
from scjax.scene import Scene


def caption_of(scene: Scene) -> str:
    """A paragraph by rule that tells every fact; a scene keeps its words."""
    return write_caption(extract_facts(scene), 0, "long", drop=0.0)
