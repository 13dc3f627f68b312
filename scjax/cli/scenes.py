"""What ``generate`` and ``demo`` do with prompts: several candidates a scene, tidied, and the best of them."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Array

from scjax.condition import Condition
from scjax.diffusion.samplers import Sampler
from scjax.model import Model
from scjax.prompts import best
from scjax.sampling import sample_many, with_counts
from scjax.scene import Scene
from scjax.tidy import tidy


def make(
    key: Array,
    prompts: Sequence[str],
    told: Sequence[Condition],
    *,
    model: Model,
    pick: int = 1,
    raw: bool = False,
    sampler: str | Sampler | None = None,
    steps: int | None = None,
    guidance: float | None = None,
    temperature: float | None = None,
) -> list[Scene]:
    """One scene a prompt: the best of ``pick`` candidates, judged as it is handed out: tidied unless ``raw``.

    Candidates of a scene have the same numbers of lanes and agents: of one size, one program makes them all at once.

    Args:
      prompts: what the best candidate is judged by.
      told: the conditions of the prompts, with their token features.
    """
    if pick > 1:
        told = with_counts(key, told, model=model)
    candidates = sample_many(
        key, [one for one in told for _ in range(pick)], model=model, sampler=sampler, steps=steps, guidance=guidance,
        temperature=temperature,
    )  # fmt: skip
    candidates = candidates if raw else [tidy(scene) for scene in candidates]
    groups = [candidates[k * pick : (k + 1) * pick] for k in range(len(prompts))]
    return [group[best(prompt, group)] if pick > 1 else group[0] for prompt, group in zip(prompts, groups, strict=True)]
