"""Scene (meters) <-> NormalizedScene (unit coordinates), under a preset of types, columns and ranges.

Sources: official-spec §1.2-1.6 for the official presets; statistics of real 64 m tiles for the ranges of the scjax
preset. Every value maps linearly, v' = 2 (v - min) / (max - min) - 1; cos and sin stay as they are.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.scene import INVERSE_LINK, STATE_COLUMNS, AgentType, AnyArray, Link, Scene, Signal
from scjax.scene.partition import elements_behind
from scjax.scene.pytree import Replaceable, pytree

Range = tuple[float, float]
LaneClasses = Literal["signal", "lights", "none"]
_LIGHT_OF_SIGNAL = {Signal.GO: 1, Signal.STOP: 2}  # lane classes of the official nuPlan preset: lane, green, red


@pytree
class NormalizedScene(Replaceable):
    """A scene or a batch of scenes in unit coordinates and a preset's types; other fields and masks as in ``Scene``.

    Attributes:
      lane_types: the preset's lane class (signal state, or lane / green light / red light).
      lane_type_known: False where the class was not recorded: for signal states, in scenes without any signal.
      agent_behind, lane_behind: the known half (x <= 0) of a partitioned scene; False everywhere in other crops.
      links: the preset's link ids, ``SceneCodec.links[id]``.
    """

    agents: Float[AnyArray, "*b agents columns"]
    agent_types: Int[AnyArray, "*b agents"]
    agent_mask: Bool[AnyArray, "*b agents"]
    agent_known: Bool[AnyArray, "*b agents columns"]
    agent_behind: Bool[AnyArray, "*b agents"]
    lanes: Float[AnyArray, "*b lanes points dims"]
    lane_types: Int[AnyArray, "*b lanes"]
    lane_type_known: Bool[AnyArray, "*b lanes"]
    lane_mask: Bool[AnyArray, "*b lanes"]
    lane_known: Bool[AnyArray, "*b lanes dims"]
    lane_behind: Bool[AnyArray, "*b lanes"]
    links: Int[AnyArray, "*b lanes lanes"]
    crop: Int[AnyArray, "*b"]
    domain: Int[AnyArray, "*b"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneCodec:
    """The types, columns and ranges of one family of models, and the conversions under them.

    Attributes:
      name: the preset's name.
      agent_types: agent classes, in the order of the logits.
      columns: agent state columns, as names of ``STATE_COLUMNS``.
      lane_classes: meaning of a lane's class: "signal" its signal state; "lights" lane, green light or red light
        (official nuPlan, where lights are separate lane tokens); "none" nothing.
      links: relations, in the order of the logits.
      point_dims: coordinates per lane point, 2 (x, y) or 3 (x, y, z).
      forward: the model's forward axis; the release's Waymo models look along +y.
      agent_z, lane_z, speed: (min, max) [m], [m], [m/s].
      sizes: per agent type, the ranges of length, width and height [m].
      clip_lanes: bound on unit lane coordinates before they are converted to meters.
    """

    name: str
    agent_types: tuple[AgentType, ...]
    columns: tuple[str, ...] = STATE_COLUMNS
    lane_classes: LaneClasses
    links: tuple[Link, ...]
    point_dims: int
    forward: Literal["x", "y"] = "x"
    agent_z: Range
    lane_z: Range
    speed: Range
    sizes: tuple[tuple[Range, Range, Range], ...]
    clip_lanes: float = 1000.0

    def __post_init__(self):
        if len(self.sizes) != len(self.agent_types):
            raise ValueError(f"{self.name}: {len(self.agent_types)} agent types but {len(self.sizes)} rows of sizes")
        if self.point_dims not in (2, 3):
            raise ValueError(f"{self.name}: point_dims must be 2 (x, y) or 3 (x, y, z), not {self.point_dims}")
        if unknown := set(self.columns) - set(STATE_COLUMNS):
            raise ValueError(f"{self.name}: unknown columns {sorted(unknown)}; known are {STATE_COLUMNS}")

    @property
    def num_lane_types(self) -> int:
        """Lane classes of the network: 4 signal states, 3 token kinds, or none."""
        return {"signal": len(Signal), "lights": 1 + len(_LIGHT_OF_SIGNAL), "none": 0}[self.lane_classes]

    @property
    def column_indices(self) -> np.ndarray:
        """Positions of ``columns`` in the nine state columns."""
        return np.array([STATE_COLUMNS.index(name) for name in self.columns])

    def normalize(self, scene: Scene) -> NormalizedScene:
        """``scene`` in unit coordinates. Its agents and lanes must be of this preset's types (see ``select``)."""
        type_of = np.zeros(len(AgentType), np.int32)
        type_of[list(self.agent_types)] = np.arange(len(self.agent_types))
        link_of = np.zeros(len(Link), np.int32)
        link_of[list(self.links)] = np.arange(len(self.links))
        agent_types = jnp.asarray(type_of)[scene.agent_types]
        agents, lanes = self._rotate(scene.agents, scene.lanes, 1)
        agents = self.normalize_agents(agents, agent_types, scene.crop)
        lanes = self.normalize_lanes(lanes[..., : self.point_dims], scene.crop)
        behind = elements_behind(scene)
        signal = self.lane_classes == "signal"
        return NormalizedScene(
            agents=jnp.where(scene.agent_mask[..., None], agents, 0.0),
            agent_types=jnp.where(scene.agent_mask, agent_types, 0),
            agent_mask=scene.agent_mask,
            agent_known=scene.agent_known[..., self.column_indices],
            agent_behind=behind.agents,
            lanes=jnp.where(scene.lane_mask[..., None, None], lanes, 0.0),
            lane_types=scene.signals if signal else self._light_classes(scene),
            lane_type_known=self._signal_known(scene) if signal else scene.lane_mask,
            lane_mask=scene.lane_mask,
            lane_known=scene.lane_known[..., : self.point_dims],
            lane_behind=behind.lanes,
            links=jnp.asarray(link_of)[scene.links],
            crop=scene.crop,
            domain=scene.domain,
        )

    def denormalize(
        self,
        agents: Float[AnyArray, "*b agents columns"],
        agent_types: Int[AnyArray, "*b agents"],
        agent_mask: Bool[AnyArray, "*b agents"],
        lanes: Float[AnyArray, "*b lanes points dims"],
        lane_types: Int[AnyArray, "*b lanes"],
        lane_mask: Bool[AnyArray, "*b lanes"],
        link_logits: Float[AnyArray, "*b lanes lanes kinds"],
        crop: Int[AnyArray, "*b"],
        domain: Int[AnyArray, "*b"],
    ) -> Scene:
        """Decoder outputs as a scene in meters, with headings of unit length and consistent links.

        A pair's relation is the one with the largest summed log-probability of both directions (i to j, and its
        inverse from j to i), so ``links`` always satisfies ``validate``.
        """
        full = jnp.zeros((*agents.shape[:-1], len(STATE_COLUMNS)), agents.dtype)
        metres = full.at[..., self.column_indices].set(self.denormalize_agents(agents, agent_types, crop))
        points = self.denormalize_lanes(lanes, crop)
        points = jnp.concatenate([points, jnp.zeros((*points.shape[:-1], 3 - self.point_dims), points.dtype)], -1)
        metres, points = self._rotate(metres, points, -1)
        heading = metres[..., 4:6]
        heading = heading / jnp.sqrt(jnp.square(heading).sum(-1, keepdims=True) + 1e-12)
        metres = metres.at[..., 4:6].set(heading).at[..., 6:9].set(jnp.maximum(metres[..., 6:9], 0.05))
        known = np.isin(STATE_COLUMNS, self.columns)
        signals = jnp.zeros_like(lane_types)
        if self.lane_classes == "signal":
            signals = lane_types
        elif self.lane_classes == "lights":
            signals = jnp.asarray([Signal.UNKNOWN, Signal.GO, Signal.STOP], jnp.int32)[lane_types]
        pairs = lane_mask[..., :, None] & lane_mask[..., None, :]
        return Scene(
            agents=jnp.where(agent_mask[..., None], metres, 0.0),
            agent_types=jnp.where(agent_mask, jnp.asarray(self.agent_types, jnp.int32)[agent_types], 0),
            agent_mask=agent_mask,
            agent_known=agent_mask[..., None] & _expand(known, metres.ndim),
            lanes=jnp.where(lane_mask[..., None, None], points, 0.0),
            lane_mask=lane_mask,
            lane_known=lane_mask[..., None] & _expand(np.arange(3) < self.point_dims, points.ndim - 1),
            signals=jnp.where(lane_mask, signals, 0).astype(jnp.int32),
            links=jnp.where(pairs, self._consistent_links(link_logits), Link.NONE).astype(jnp.int32),
            crop=crop,
            domain=domain,
        )

    def normalize_agents(
        self, agents: Float[AnyArray, "*b n 9"], types: Int[AnyArray, "*b n"], crop: Int[AnyArray, "*b"]
    ) -> Float[Array, "*b n columns"]:
        """Meters -> unit, without clipping; ``types`` are this preset's, and only ``columns`` are rerotated."""
        low, high = self._agent_ranges(types, crop)
        return (2 * (jnp.asarray(agents) - low) / (high - low) - 1)[..., self.column_indices]

    def denormalize_agents(
        self, unit: Float[AnyArray, "*b n columns"], types: Int[AnyArray, "*b n"], crop: Int[AnyArray, "*b"]
    ) -> Float[Array, "*b n columns"]:
        """Unit -> meters; every field is clipped to [-1, 1] first (official-spec §1.6)."""
        low, high = (r[..., self.column_indices] for r in self._agent_ranges(types, crop))
        return (jnp.clip(unit, -1, 1) + 1) / 2 * (high - low) + low

    def normalize_lanes(
        self, lanes: Float[AnyArray, "*b n points dims"], crop: Int[AnyArray, "*b"]
    ) -> Float[Array, "*b n points dims"]:
        """Meters -> unit for the first ``point_dims`` coordinates."""
        low, high = self._lane_ranges(crop)
        return 2 * (jnp.asarray(lanes) - low) / (high - low) - 1

    def denormalize_lanes(
        self, unit: Float[AnyArray, "*b n points dims"], crop: Int[AnyArray, "*b"], clip: float | None = None
    ) -> Float[Array, "*b n points dims"]:
        """Unit -> meters; clipped to ``clip_lanes``, or to ``clip`` (the collision penalty uses 1)."""
        bound = self.clip_lanes if clip is None else clip
        low, high = self._lane_ranges(crop)
        return (jnp.clip(unit, -bound, bound) + 1) / 2 * (high - low) + low

    def select(self, scene: Scene) -> Scene:
        """The part of one NumPy scene that this preset can express, unpadded.

        Agents of other classes are left out. Where lights are tokens, every lane with a known signal adds a light
        token without links.
        """
        keep = scene.agent_mask & np.isin(scene.agent_types, self.agent_types)
        lanes = np.flatnonzero(scene.lane_mask)
        lit = lanes[:0]
        if self.lane_classes == "lights":
            lit = lanes[np.isin(scene.signals[lanes], list(_LIGHT_OF_SIGNAL))]
        rows = np.concatenate([lanes, lit])
        links = np.zeros((len(rows), len(rows)), np.int32)
        links[: len(lanes), : len(lanes)] = scene.links[np.ix_(lanes, lanes)]
        links[~np.isin(links, self.links)] = Link.NONE
        np.fill_diagonal(links, Link.SELF)
        signals = scene.signals[rows].copy()
        if self.lane_classes != "signal":
            signals[: len(lanes)] = Signal.UNKNOWN  # a lane token; only light tokens have a state
        return scene.replace(
            agents=scene.agents[keep],
            agent_types=scene.agent_types[keep],
            agent_mask=scene.agent_mask[keep],
            agent_known=scene.agent_known[keep],
            lanes=scene.lanes[rows],
            lane_mask=scene.lane_mask[rows],
            lane_known=scene.lane_known[rows],
            signals=signals,
            links=links,
        )

    def _agent_ranges(self, types: Int[AnyArray, "*b n"], crop: Int[AnyArray, "*b"]) -> tuple[Array, Array]:
        """(min, max) of the nine columns for every agent, [*b, n, 9]."""
        table = np.zeros((len(self.agent_types), 9, 2), np.float32)
        table[:, 2], table[:, 3], table[:, 4:6], table[:, 6:9] = self.agent_z, self.speed, (-1, 1), self.sizes
        rows = jnp.asarray(table)[types]
        xy = self._window(crop)[..., None, :, :]
        rows = rows.at[..., :2, :].set(jnp.broadcast_to(xy, (*rows.shape[:-2], 2, 2)))
        return rows[..., 0], rows[..., 1]

    def _lane_ranges(self, crop: Int[AnyArray, "*b"]) -> tuple[Array, Array]:
        """(min, max) of x, y (, z), broadcastable to [*b, n, points, dims]."""
        rows = self._window(crop)
        z = jnp.broadcast_to(jnp.asarray(self.lane_z), (*rows.shape[:-2], 1, 2))
        rows = jnp.concatenate([rows, z], -2)[..., None, None, : self.point_dims, :]
        return rows[..., 0], rows[..., 1]

    def _window(self, crop: Int[AnyArray, "*b"]) -> Float[Array, "*b 2 2"]:
        """(min, max) of x and y: the square around the ego, or the 64 m ahead of it."""
        centered, ahead = (-32.0, 32.0), (0.0, 64.0)
        forward = (ahead, centered) if self.forward == "x" else (centered, ahead)
        table = jnp.asarray([(centered, centered), (centered, centered), forward])
        return table[jnp.asarray(crop)]

    def _rotate(self, agents, lanes, sign: int):
        """Agents and lanes rotated from x-forward to this preset's axes (sign 1) or back (sign -1)."""
        if self.forward == "x":
            return jnp.asarray(agents), jnp.asarray(lanes)
        agents, lanes = jnp.asarray(agents), jnp.asarray(lanes)
        rotated = agents.at[..., 0].set(-sign * agents[..., 1]).at[..., 1].set(sign * agents[..., 0])
        rotated = rotated.at[..., 4].set(-sign * agents[..., 5]).at[..., 5].set(sign * agents[..., 4])
        return rotated, lanes.at[..., 0].set(-sign * lanes[..., 1]).at[..., 1].set(sign * lanes[..., 0])

    @staticmethod
    def _signal_known(scene: Scene) -> Bool[AnyArray, "*b lanes"]:
        """In scenes with any signal, lanes without one have none, which is known; other scenes did not record
        signals."""
        recorded = scene.lane_mask & (scene.signals != Signal.UNKNOWN)
        return scene.lane_mask & recorded.any(-1, keepdims=True)

    def _light_classes(self, scene: Scene) -> Int[Array, "*b lanes"]:
        table = np.zeros(len(Signal), np.int32)
        if self.lane_classes == "lights":
            table[list(_LIGHT_OF_SIGNAL)] = list(_LIGHT_OF_SIGNAL.values())
        return jnp.asarray(table)[scene.signals]

    def _consistent_links(self, logits: Float[AnyArray, "*b n n kinds"]) -> Int[Array, "*b n n"]:
        """Argmax of the summed log-probabilities of i -> j and of the inverse relation j -> i; SELF on the diagonal.

        Entries below the diagonal are the inverses of those above: for equal sums the two argmaxes could disagree.
        """
        inverse = np.array([self.links.index(Link(INVERSE_LINK[link])) for link in self.links])
        scores = jax.nn.log_softmax(jnp.asarray(logits), -1)
        scores = scores + jnp.swapaxes(scores, -2, -3)[..., inverse]
        self_id = self.links.index(Link.SELF)
        best = jnp.argmax(scores.at[..., self_id].set(-jnp.inf), -1)
        lower = _expand(np.tri(logits.shape[-2], k=-1, dtype=bool), best.ndim)
        best = jnp.where(lower, jnp.asarray(inverse)[jnp.swapaxes(best, -1, -2)], best)
        diagonal = _expand(np.eye(logits.shape[-2], dtype=bool), best.ndim)
        return jnp.where(diagonal, Link.SELF, jnp.asarray(self.links, jnp.int32)[best])


def _expand(array: np.ndarray, rank: int) -> np.ndarray:
    """``array`` with leading axes of length one, up to ``rank`` axes."""
    return array.reshape((1,) * (rank - array.ndim) + array.shape)


_OFFICIAL_LINKS = (Link.NONE, Link.PREDECESSOR, Link.SUCCESSOR, Link.SELF)
_ALL_LINKS = tuple(Link)


def scjax() -> SceneCodec:
    """The default: four agent classes with their own ranges, lanes with z, signal states and neighbors."""
    return SceneCodec(
        name="scjax",
        agent_types=tuple(AgentType),
        lane_classes="signal",
        links=_ALL_LINKS,
        point_dims=3,
        agent_z=(-8.0, 8.0),
        lane_z=(-8.0, 8.0),
        speed=(0.0, 35.0),
        sizes=(
            ((0.0, 20.0), (0.0, 3.5), (0.0, 4.5)),
            ((0.0, 2.0), (0.0, 2.0), (0.0, 2.5)),
            ((0.0, 3.0), (0.0, 1.5), (0.0, 2.5)),
            ((0.0, 6.0), (0.0, 6.0), (0.0, 3.0)),
        ),
    )


def official_nuplan() -> SceneCodec:
    """The nuPlan models of the release (official-spec §1.6): 2-D lanes, lights as lane tokens, three agent classes."""
    sizes = ((0.09, 19.77), (0.14, 7.20), (0.2, 3.5))
    return SceneCodec(
        name="official_nuplan",
        agent_types=(AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.STATIC),
        lane_classes="lights",
        links=_OFFICIAL_LINKS,
        point_dims=2,
        agent_z=(-2.5, 2.5),
        lane_z=(-2.5, 2.5),
        speed=(0.0, 29.19),
        sizes=(sizes, sizes, sizes),
    )


def official_waymo() -> SceneCodec:
    """The Waymo models of the release: +y forward, no z and height, no lane classes, neighbors among the links."""
    sizes = ((-0.098, 22.929), (0.096, 12.527), (0.2, 3.5))
    return SceneCodec(
        name="official_waymo",
        agent_types=(AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST),
        columns=("x", "y", "speed", "cos", "sin", "length", "width"),
        lane_classes="none",
        links=_ALL_LINKS,
        point_dims=2,
        forward="y",
        agent_z=(-2.5, 2.5),
        lane_z=(-2.5, 2.5),
        speed=(0.0, 114.088),
        sizes=(sizes, sizes, sizes),
    )


PRESETS = {"scjax": scjax, "official_nuplan": official_nuplan, "official_waymo": official_waymo}
