"""The scene type: one moment of a driving scene, or a batch of them, as padded and masked arrays in SI units.

Networks read and write this type; ``Log`` is the type with time. Frame: x forward, y left, z up, the ego (agent 0) at
the origin facing +x. A batch is a scene with leading axes. Padding is all zeros and never read.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.scene.limits import MAX_COORDINATE, MAX_SIZE, MAX_SPEED
from scjax.scene.pytree import Replaceable, pytree

AnyArray = Array | np.ndarray  # on a device or on the host

STATE_COLUMNS = ("x", "y", "z", "speed", "cos", "sin", "length", "width", "height")
POINTS_PER_LANE = 20
MAX_LANES = 100
MAX_AGENTS = 61
TILE_SIZE = 64.0  # m, edge of the square window
LARGE_LENGTH = 7.0  # m; longer vehicles, such as buses and trucks, are large


class AgentType(enum.IntEnum):
    """Class of an agent; STATIC are cones, barriers and other obstacles."""

    VEHICLE = 0
    PEDESTRIAN = 1
    CYCLIST = 2
    STATIC = 3


class Signal(enum.IntEnum):
    """State of the signal that controls a lane. UNKNOWN includes "no signal": sources rarely distinguish the two."""

    UNKNOWN = 0
    GO = 1
    CAUTION = 2
    STOP = 3


class Link(enum.IntEnum):
    """Relation of lane i to lane j in ``links[i, j]``: PREDECESSOR means traffic flows from i into j."""

    NONE = 0
    PREDECESSOR = 1
    SUCCESSOR = 2
    LEFT = 3
    RIGHT = 4
    SELF = 5


INVERSE_LINK = np.array([Link.NONE, Link.SUCCESSOR, Link.PREDECESSOR, Link.RIGHT, Link.LEFT, Link.SELF], np.int32)


class Crop(enum.IntEnum):
    """Which window of the world a scene shows (official-spec §1.5)."""

    CENTERED = 0  # |x|, |y| <= 32 m: F_P of the paper
    PARTITIONED = 1  # the same window, every lane cut at x = 0: for completion and outpainting
    FORWARD = 2  # 0 <= x <= 64 m, |y| <= 32 m: F_I of the paper


@pytree
class Scene(Replaceable):
    """A scene, or a batch of scenes with leading axes ``*b``.

    Attributes:
      agents: box center x, y, z [m], speed [m/s], cos and sin of the heading, length, width, height [m].
      agent_types: ``AgentType``.
      agent_mask: True for real agents; agent 0 is the ego.
      agent_known: False where the source did not record the value and a fill (0, class mean) replaces it.
      lanes: centerlines in driving direction, equally spaced in xy arc length [m]; z above the ground under the ego.
      lane_mask: True for real lanes.
      lane_known: as ``agent_known``, for x, y, z of the whole lane.
      signals: ``Signal`` of each lane.
      links: ``Link`` of lane i (row) to lane j (column); SELF on the diagonal of real lanes.
      crop: ``Crop``.
      domain: index of the data set or city in the model's list of domains.
    """

    agents: Float[AnyArray, "*b agents 9"]
    agent_types: Int[AnyArray, "*b agents"]
    agent_mask: Bool[AnyArray, "*b agents"]
    agent_known: Bool[AnyArray, "*b agents 9"]
    lanes: Float[AnyArray, "*b lanes points 3"]
    lane_mask: Bool[AnyArray, "*b lanes"]
    lane_known: Bool[AnyArray, "*b lanes 3"]
    signals: Int[AnyArray, "*b lanes"]
    links: Int[AnyArray, "*b lanes lanes"]
    crop: Int[AnyArray, "*b"]
    domain: Int[AnyArray, "*b"]

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes ``*b``; ``()`` for a single scene."""
        return tuple(self.agent_mask.shape[:-1])

    @property
    def num_agents(self) -> Array | np.ndarray | np.integer:
        """Real agents, [*b], ego included."""
        return self.agent_mask.sum(-1)

    @property
    def num_lanes(self) -> Array | np.ndarray | np.integer:
        """Real lanes, [*b]."""
        return self.lane_mask.sum(-1)

    def __getitem__(self, index) -> Scene:
        """A scene, or a sub-batch, of a batch: ``scenes[0]``, ``scenes[3:7]``."""
        if not self.batch_shape:
            raise IndexError("this is a single scene, not a batch: there is nothing to index")
        fields = {name: value[index] for name, value in self.to_dict().items()}
        if isinstance(self.crop, np.ndarray):  # one element of a NumPy array is a scalar, no array any more
            fields = {name: np.asarray(value) for name, value in fields.items()}
        return self.replace(**fields)

    def to_dict(self) -> dict[str, Array | np.ndarray]:
        """Field name -> array, without copies."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def to_numpy(self) -> Scene:
        """The same scene on the host."""
        return self.replace(**{name: np.asarray(value) for name, value in self.to_dict().items()})


def empty(num_agents: int, num_lanes: int, *, crop: Crop = Crop.CENTERED, domain: int = 0) -> Scene:
    """A NumPy scene of padding only, to be filled in: num_agents and num_lanes slots, no batch axes."""
    return Scene(
        agents=np.zeros((num_agents, len(STATE_COLUMNS)), np.float32),
        agent_types=np.zeros(num_agents, np.int32),
        agent_mask=np.zeros(num_agents, bool),
        agent_known=np.zeros((num_agents, len(STATE_COLUMNS)), bool),
        lanes=np.zeros((num_lanes, POINTS_PER_LANE, 3), np.float32),
        lane_mask=np.zeros(num_lanes, bool),
        lane_known=np.zeros((num_lanes, 3), bool),
        signals=np.zeros(num_lanes, np.int32),
        links=np.zeros((num_lanes, num_lanes), np.int32),
        crop=np.asarray(crop, np.int32),
        domain=np.asarray(domain, np.int32),
    )


def pad(scene: Scene, num_agents: int, num_lanes: int) -> Scene:
    """``scene`` (NumPy, any batch axes) with its agent and lane axes grown to the given sizes.

    Raises:
      ValueError: if the scene has more slots than that; masked slots are not dropped silently.
    """
    extra_agents = num_agents - scene.agent_mask.shape[-1]
    extra_lanes = num_lanes - scene.lane_mask.shape[-1]
    if extra_agents < 0 or extra_lanes < 0:
        raise ValueError(
            f"cannot pad a scene of {scene.agent_mask.shape[-1]} agent and {scene.lane_mask.shape[-1]} lane slots "
            f"to {num_agents} and {num_lanes}: choose larger sizes or crop the scene first"
        )
    lead = [(0, 0)] * len(scene.batch_shape)
    agents, lanes = [*lead, (0, extra_agents)], [*lead, (0, extra_lanes)]
    widths = {
        "agents": [*agents, (0, 0)],
        "agent_types": agents,
        "agent_mask": agents,
        "agent_known": [*agents, (0, 0)],
        "lanes": [*lanes, (0, 0), (0, 0)],
        "lane_mask": lanes,
        "lane_known": [*lanes, (0, 0)],
        "signals": lanes,
        "links": [*lanes, (0, extra_lanes)],
        "crop": lead,
        "domain": lead,
    }
    # np.pad refuses the empty widths of the scalars crop and domain.
    padded = {name: np.pad(np.asarray(getattr(scene, name)), width) for name, width in widths.items() if width}
    return scene.replace(**padded)


def permute(scene: Scene, agents: np.ndarray, lanes: np.ndarray) -> Scene:
    """One NumPy scene whose row i is row ``agents[i]`` / ``lanes[i]`` of ``scene``; also selects and repeats rows."""
    return scene.replace(
        agents=scene.agents[agents],
        agent_types=scene.agent_types[agents],
        agent_mask=scene.agent_mask[agents],
        agent_known=scene.agent_known[agents],
        lanes=scene.lanes[lanes],
        lane_mask=scene.lane_mask[lanes],
        lane_known=scene.lane_known[lanes],
        signals=scene.signals[lanes],
        links=scene.links[np.ix_(lanes, lanes)],
    )


def unpadded(scene: Scene) -> Scene:
    """One NumPy scene without its padding."""
    return permute(scene, np.flatnonzero(scene.agent_mask), np.flatnonzero(scene.lane_mask))


def stack(scenes: Sequence[Scene], slots: tuple[int, int] | None = None) -> Scene:
    """Single NumPy scenes as one batch [len(scenes)], padded to ``slots`` (agents, lanes) or to the largest of them.

    Raises:
      ValueError: on an empty list, or a scene with more slots than that.
    """
    if not scenes:
        raise ValueError("cannot stack an empty list of scenes: give at least one")
    largest = tuple(max(getattr(scene, name).shape[-1] for scene in scenes) for name in ("agent_mask", "lane_mask"))
    agents, lanes = slots or largest
    if agents < largest[0] or lanes < largest[1]:
        raise ValueError(
            f"cannot stack scenes of up to {largest[0]} agent and {largest[1]} lane slots in {agents} and {lanes}: "
            "choose larger sizes or crop the scenes first"
        )
    batch = {}
    for name in scenes[0].to_dict():
        parts = [np.asarray(getattr(scene, name)) for scene in scenes]
        rows = agents if name.startswith("agent") else lanes
        shape = (lanes, lanes) if name == "links" else (rows, *parts[0].shape[1:]) if parts[0].ndim else ()
        # Filled in place: growing the scenes one by one took a fifth of a training step.
        batch[name] = np.zeros((len(scenes), *shape), np.result_type(*parts))
        for row, part in enumerate(parts):
            batch[name][(row, *map(slice, part.shape))] = part
    return Scene(**batch)


def validate(scene: Scene) -> Scene:
    """``scene`` itself, if every invariant of the type holds (host-side check, any batch axes).

    Raises:
      ValueError: naming the first field at fault, what is wrong and how to mend it.
    """
    host = scene.to_numpy()
    _check_arrays(host)
    _check_values(host)
    _check_links(host)
    return scene


def _check_arrays(host: Scene) -> None:
    """Kinds and shapes of all arrays."""
    for name, blank in empty(0, 0).to_dict().items():
        value, kind = getattr(host, name), np.dtype(blank.dtype).kind
        if value.dtype.kind not in ("iu" if kind == "i" else kind):
            raise ValueError(f"{name} is of type {value.dtype}: give it as {blank.dtype}")
    if not host.agent_mask.ndim or not host.lane_mask.ndim:
        raise ValueError("agent_mask and lane_mask must have an axis of agents and one of lanes")
    lead, num_agents, num_lanes = host.batch_shape, host.agent_mask.shape[-1], host.lane_mask.shape[-1]
    shapes = {
        "agents": (*lead, num_agents, 9),
        "agent_types": (*lead, num_agents),
        "agent_known": (*lead, num_agents, 9),
        "lanes": (*lead, num_lanes, POINTS_PER_LANE, 3),
        "lane_mask": (*lead, num_lanes),
        "lane_known": (*lead, num_lanes, 3),
        "signals": (*lead, num_lanes),
        "links": (*lead, num_lanes, num_lanes),
        "crop": lead,
        "domain": lead,
    }
    for name, shape in shapes.items():
        if getattr(host, name).shape != shape:
            raise ValueError(
                f"{name} has shape {getattr(host, name).shape}, but agent_mask {host.agent_mask.shape} and lane_mask "
                f"{host.lane_mask.shape} call for {shape}"
            )


def _check_values(host: Scene) -> None:
    """Ranges of numbers and enums of real elements."""
    for name, mask in (("agents", host.agent_mask), ("lanes", host.lane_mask)):
        values = getattr(host, name)
        axes = tuple(range(mask.ndim, values.ndim))
        finite = np.isfinite(values).all(axis=axes)
        if (mask & ~finite).any():
            raise ValueError(f"{name}{_first(mask & ~finite)} holds NaN or infinity: fill it and clear its known flag")
        near = (np.abs(values[..., :3]) < MAX_COORDINATE).all(axis=axes)
        if (mask & ~near).any():
            raise ValueError(
                f"{name}{_first(mask & ~near)} is {MAX_COORDINATE:g} m or more from the origin: correct its coordinates"
            )
    sizes = host.agents[..., 6:9][host.agent_mask]
    if (sizes <= 0).any():
        raise ValueError("agents have a length, width or height of 0 m or less: fill it with the mean of its class")
    if (sizes > MAX_SIZE).any():
        raise ValueError(f"agents have a length, width or height above {MAX_SIZE:g} m: correct it")
    if (np.abs(host.agents[..., 3][host.agent_mask]) > MAX_SPEED).any():
        raise ValueError(f"agents have a speed above {MAX_SPEED:g} m/s: correct it")
    norm = np.hypot(host.agents[..., 4], host.agents[..., 5])[host.agent_mask]
    if (np.abs(norm - 1) > 1e-2).any():
        raise ValueError("cos and sin of a heading (agent columns 4 and 5) are not a unit vector: normalize them")
    for name, mask, enum_type in (
        ("agent_types", host.agent_mask, AgentType),
        ("signals", host.lane_mask, Signal),
        ("links", host.lane_mask[..., :, None] & host.lane_mask[..., None, :], Link),
        ("crop", np.ones(host.batch_shape, bool), Crop),
    ):
        values = getattr(host, name)[mask]
        if values.size and not (0 <= values.min() and values.max() < len(enum_type)):
            highest = len(enum_type) - 1
            raise ValueError(f"{name} holds values outside 0..{highest}: use values of {enum_type.__name__}")
    if (host.domain < 0).any():
        raise ValueError("domain holds values below 0: give indices into the list of domains")


def _first(faulty: np.ndarray) -> list[int]:
    return [int(i) for i in np.argwhere(faulty)[0]]


def _check_links(host: Scene) -> None:
    """SELF on the diagonal, and the inverse relation across it."""
    pairs = host.lane_mask[..., :, None] & host.lane_mask[..., None, :]
    transposed = np.swapaxes(host.links, -1, -2)
    diagonal = np.broadcast_to(np.eye(pairs.shape[-1], dtype=bool), pairs.shape)
    if (host.links[pairs & diagonal] != Link.SELF).any() or (host.links[pairs & ~diagonal] == Link.SELF).any():
        raise ValueError("links must be SELF exactly on the diagonal of real lanes")
    # Two lanes that precede each other (a ring of two) have PREDECESSOR in both directions.
    ring = (host.links == Link.PREDECESSOR) & (transposed == Link.PREDECESSOR)
    if ((INVERSE_LINK[host.links.clip(0, 5)] != transposed) & pairs & ~ring).any():
        raise ValueError("links[i, j] and links[j, i] disagree: the inverse of predecessor is successor, of left right")
