"""What ``generate`` and ``demo`` do with prompts: several candidates a scene, tidied, and the best of them."""

from __future__ import annotations

from collections.abc import Sequence

import jax
from jaxtyping import Array

from scjax.diffusion.samplers import Sampler
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.prompts import SceneScore, score_scene
from scjax.generate.sample import GROUP, sample_many, with_counts
from scjax.scene import Scene
from scjax.scene.per_type import PerType
from scjax.scene.repair import repair


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
    temperature: float | PerType | None = None,
    energy_guidance: bool | None = None,
) -> list[Scene]:
    """One scene a prompt: the best of ``pick`` candidates, judged as it is handed out: tidied unless ``raw``.

    They are made some at a time, and one that shows everything and has no fault ends the search. Candidates of a scene
    have the same numbers of lanes and agents, so that one program makes them.

    Args:
      prompts: what the best candidate is judged by.
      told: the conditions of the prompts, with their token features.
    """

    def sampled(key: Array, rows: Sequence[int], times: int) -> list[Scene]:
        made = sample_many(
            key, [told[row] for row in rows for _ in range(times)], model=model, sampler=sampler, steps=steps,
            guidance=guidance, temperature=temperature, energy_guidance=energy_guidance,
        )  # fmt: skip
        return made if raw else [repair(scene) for scene in made]

    if pick == 1:
        return sampled(key, range(len(prompts)), 1)
    told = with_counts(key, told, model=model)
    best: dict[int, tuple[SceneScore, Scene]] = {}
    done = 0
    while done < pick:
        rows = [row for row in range(len(prompts)) if row not in best or best[row][0][:2] > (0, 0)]
        if not rows:
            break
        times = min(GROUP, pick - done)
        made = iter(sampled(jax.random.fold_in(key, done) if done else key, rows, times))
        for row in rows:
            judged = [(score_scene(prompts[row], scene), scene) for scene in (next(made) for _ in range(times))]
            best[row] = min([*([best[row]] if row in best else []), *judged], key=lambda one: one[0])
        done += times
    return [best[row][1] for row in range(len(prompts))]
