"""The kinds of all tokens of a scene to sample, for networks that read kinds: an outline fitted to the request."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from scjax.generate.agent_draw import AgentDraw, Kinds
from scjax.generate.components import Model
from scjax.generate.lane_places import along_lanes, settle_agents
from scjax.generate.scene_spec import SceneSpec
from scjax.language.attributes.table import GROUPS
from scjax.models.denoiser.kinds import FAR, NO_KIND, digits_of, scene_kinds
from scjax.scene import Crop, Scene, pad
from scjax.scene.per_type import PerType

_ABOUT_ROADS = {item.name for group in ("Road", "Lanes", "Signals") for item in GROUPS[group]} | {"ego_manoeuvre"}


@dataclasses.dataclass(frozen=True)
class Outline:
    """Kinds of the tokens of one scene, in token order; known elements come first.

    Attributes:
      lanes: of the known lanes alone, if there are any and the number of further ones is open.
      domain: index of the domain.
      num_lanes: the number of all lanes; None: it is open.
      along: agents that are to go along a lane, where all lanes are known, or those behind a seam; else None.
    """

    agents: Kinds
    lanes: Kinds
    domain: int
    num_lanes: int | None = None
    along: Bool[np.ndarray, " agents"] | None = None


def draw_outline(rng: np.random.Generator, spec: SceneSpec, model: Model, view: int | None = None) -> Outline | None:
    """An outline of the training that shows most of the request, with agents added or left out to its numbers.

    Where all lanes are known, the request's roads do not count: the outline is one of those with the most similar
    lanes, so that its agents make sense there. With a picture, it is one of those that look most like it.

    Args:
      view: number of the outline of a window that looks like the picture (``draw_view``); None: no picture.

    Returns:
      None where the network decides: the model has no outlines, or none for this window.
    """
    if not model.denoiser.config.agent_kinds:
        return None
    if view is not None:
        return _draw_view(rng, spec, view, model)
    if model.outlines is None:
        return None
    if spec.crop == Crop.PARTITIONED and model.outlines.ahead is not None and spec.known is not None:
        return _draw_continuation(rng, spec, spec.known.tokens, model)
    if spec.crop != Crop.CENTERED:
        return None
    known, known_lanes, domain = _known_tokens(spec), None, spec.domain
    request, negative, likely = spec.attributes, spec.negative_attributes, spec.likely
    if known is not None and len(known.lane_mask) == spec.num_lanes:
        request, negative, likely = _of_agents(request), _of_agents(negative), _of_agents(likely)
        known_lanes = _known_kinds(known, model).lanes
    draw = AgentDraw(rng, model.outlines.agents, model.codec, spec.attributes)
    row = model.outlines.draw(
        rng,
        request,
        likely=likely,
        negative=negative,
        domain=domain,
        num_lanes=spec.num_lanes,
        num_agents=spec.num_agents,
        lanes=known_lanes,
        count_misses=draw.count_misses,
    )
    agents, lanes = (valid_tokens(kinds[row]) for kinds in (model.outlines.agents, model.outlines.lanes))
    agents = draw.fit(agents, model.outlines.missed_by(row, spec.attributes))
    num_known = 1
    if known is not None and len(known.agent_mask):
        agents = draw.replace(agents, _known_kinds(known, model).agents)
        num_known = len(known.agent_mask)
    agents = _cut_or_fill(rng, agents[: model.denoiser.config.max_agents], spec.num_agents, num_known)
    along = None
    if known is not None and known_lanes is not None:
        settled = settle_agents(rng, agents, known, model.codec)
        agents = agents if settled is None else _known_kinds(settled, model).agents
        along = along_lanes(agents, model.codec) & (np.arange(len(agents)) >= num_known)
    if known is not None and len(known.lane_mask):
        lanes = _known_kinds(known, model).lanes
    else:
        lanes = _cut_or_fill(rng, lanes, spec.num_lanes, 0)
    domain = int(model.outlines.domains[row]) if domain is None else domain
    num_lanes = None if known is not None and len(known.lane_mask) else len(lanes)
    return Outline(agents, lanes, domain, num_lanes, along)


def _draw_view(rng: np.random.Generator, spec: SceneSpec, row: int, model: Model) -> Outline:
    """The outline of a window that looks like the picture, with agents added or left out to the request's numbers.

    Agents that are known take the places of those most like them.
    """
    views, config, known, domain = model.views, model.denoiser.config, _known_tokens(spec), spec.domain
    assert views is not None
    agents, lanes = (valid_tokens(kinds[row]) for kinds in (views.agents, views.lanes))
    agents = AgentDraw(rng, views.agents, model.codec, spec.attributes).fit(agents)
    num_known = 1
    if known is not None:
        agents = _with_known(agents, _known_kinds(known, model).agents, views.agent_sizes)
        num_known = len(known.agent_mask)
    agents = _cut_or_fill(rng, agents[: config.max_agents], spec.num_agents, num_known)
    lanes = _cut_or_fill(rng, lanes, spec.num_lanes, 0)
    return Outline(agents, lanes, int(views.domains[row]) if domain is None else domain, len(lanes))


def _with_known(kinds: Kinds, known: Kinds, sizes: Sequence[int]) -> Kinds:
    """The kinds of known agents, the ego first, and others: the most similar one of each one's class is left out.

    So are those near on the ego's road: a picture would show them.
    """
    rest = kinds[1:]
    for own in np.stack(digits_of(known[1:], sizes), 1)[..., None]:
        if not len(rest):
            break
        others = np.stack(digits_of(rest, sizes))
        same = np.where(others[0] == own[0], (others == own).sum(0), -1)
        if same.max() >= 0:
            rest = np.delete(rest, int(same.argmax()))
    side, distance = digits_of(rest, sizes)[-2:]
    return np.concatenate([known, rest[(side == 0) | (distance == FAR)]]).astype(kinds.dtype)


def _draw_continuation(rng: np.random.Generator, spec: SceneSpec, known: Scene, model: Model) -> Outline:
    """Kinds of the known half, and of what lies beyond a like seam in a scene that shows most of the request.

    Requested numbers of agents are those beyond the seam.
    """
    outlines, config, domain = model.outlines, model.denoiser.config, spec.domain
    assert outlines is not None and outlines.ahead is not None
    request, negative = spec.attributes, spec.negative_attributes
    among = outlines.ahead.nearest(known)
    row = outlines.draw(rng, request, negative=negative, domain=domain, among=among)
    kinds = _known_kinds(known, model)
    agents, lanes = kinds.agents, kinds.lanes
    draw = AgentDraw(rng, outlines.agents, model.codec, request)
    new = draw.fit(np.concatenate([agents[:1], valid_tokens(outlines.ahead.agents[row])]))[1:]
    agents = np.concatenate([agents, new])[: config.max_agents]
    agents = _cut_or_fill(rng, agents, spec.num_agents, len(known.agent_mask))
    lanes = np.concatenate([lanes, valid_tokens(outlines.ahead.lanes[row])])[: config.max_lanes]
    lanes = _cut_or_fill(rng, lanes, spec.num_lanes, len(known.lane_mask))
    domain = int(outlines.domains[row]) if domain is None else domain
    along = along_lanes(agents, model.codec) & (np.arange(len(agents)) >= len(known.agent_mask))
    return Outline(agents, lanes, domain, len(lanes), along)


def _known_tokens(spec: SceneSpec) -> Scene | None:
    """Known elements in token order, unpadded; None: none."""
    return None if spec.known is None else spec.known.tokens


def _known_kinds(known: Scene, model: Model) -> PerType:
    """Kinds of known elements (NumPy). They are padded, so that one program serves all numbers of them."""
    config, agents, lanes = model.denoiser.config, len(known.agent_mask), len(known.lane_mask)
    padded = pad(known, max(config.max_agents, agents), max(config.max_lanes, lanes))
    kinds = _compiled_kinds(padded, codec=model.codec)
    return PerType(agents=np.asarray(kinds.agents)[:agents], lanes=np.asarray(kinds.lanes)[:lanes])


_compiled_kinds = jax.jit(scene_kinds, static_argnames=("codec",))


def _of_agents(request: Mapping[str, Any]) -> dict[str, Any]:
    """What a request says of other things than roads, which are known."""
    return {name: value for name, value in request.items() if name not in _ABOUT_ROADS}


def valid_tokens(kinds: Kinds) -> Kinds:
    """The kinds of one scene without padding."""
    return kinds[kinds != NO_KIND].astype(np.int32)


def _cut_or_fill(rng: np.random.Generator, kinds: Kinds, number: int | None, first: int) -> Kinds:
    """``number`` kinds: some left out at random after the ``first``, or ``NO_KIND`` added."""
    if number is None:
        return kinds
    surplus = len(kinds) - number
    if surplus > 0:
        return np.delete(kinds, first + rng.permutation(len(kinds) - first)[:surplus])
    return np.append(kinds, np.full(-surplus, NO_KIND, kinds.dtype))
