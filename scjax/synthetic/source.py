"""Synthetic worlds as a source of records: ``build(Worlds(seed, count), out)``."""

from __future__ import annotations

import collections
import dataclasses
import hashlib

import numpy as np

from scjax.data.build_options import BuildOptions, PosedLog
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.readers.base import LogInfo
from scjax.data.tiles import pose_of
from scjax.language.events import EVENTS
from scjax.synthetic import domains
from scjax.synthetic.labels import Label, label
from scjax.synthetic.world import VERSION, make_world, object_of, raw_scene

_SAME_EVENT = 2  # scenes of a world that are kept for showing the same event: a jam is seen by many cars


@dataclasses.dataclass(frozen=True)
class Worlds:
    """Worlds 0 .. ``count`` - 1 of ``seed``; each is a location of its own. Poses come from the worlds, all standard.

    Attributes:
      ordinary: share of the scenes that show nothing rare (``Label.rare``) that is kept; a world's third and further
        scenes of the same event count as ordinary. Less than 1 gives a training set in which rare things are frequent.
      events: of which every world with a place for it shows one; one told twice is drawn twice as often. Empty: any
        event in some worlds.

    Raises:
      ValueError: if ``count`` is less than 1, ``seed`` negative, ``ordinary`` no share, or an event is unknown.
    """

    seed: int
    count: int
    ordinary: float = 1.0
    events: tuple[str, ...] = ()

    def __post_init__(self):
        if not 0 <= self.ordinary <= 1:
            raise ValueError(f"ordinary is {self.ordinary}: give a share from 0 to 1")
        if unknown := set(self.events) - set(EVENTS):
            raise ValueError(f"unknown event {min(unknown)!r}: choose of {', '.join(EVENTS)}")
        if self.count < 1 or self.seed < 0:
            raise ValueError(
                f"count is {self.count} and seed {self.seed}: give at least one world, a seed of 0 or more"
            )

    def names(self) -> list[str]:
        """``seed/k`` of every world."""
        return [f"{self.seed}/{k:07d}" for k in range(self.count)]

    def scan(self, name: str) -> LogInfo:
        """Domain of the world, without making it."""
        seed, k = (int(part) for part in name.split("/"))
        domain = domains.draw(np.random.default_rng([VERSION, seed, k])).name
        options = " ".join([f"{self.ordinary:g} {_SAME_EVENT}", *self.events])
        digest = hashlib.sha256(f"synthetic world {VERSION} {name} {options}".encode()).hexdigest()
        return LogInfo(name, digest, domain, name)

    def load(self, item: LogInfo, options: BuildOptions, dense: bool) -> PosedLog:
        """Makes the world; the options do not matter to it."""
        del options, dense
        seed, k = (int(part) for part in item.file.split("/"))
        world = make_world(seed, k, self.events)
        raw = raw_scene(world)
        graph = build_graph(raw)
        index = index_segments(graph)
        chance = np.random.default_rng([VERSION, seed, k, 1]).random(len(world.egos))
        labels = [label(world, ego) for ego in world.egos]
        kept = np.flatnonzero((chance < self.ordinary) | _rare(labels, chance))
        egos = [world.egos[k] for k in kept]
        poses = [pose_of(raw, index, ego.moment, object_of(world, ego.moment, ego.agent)) for ego in egos]
        return PosedLog(raw, graph, index, poses, len(poses), [labels[k].to_json() for k in kept], keep_parked=True)


def _rare(labels: list[Label], chance: np.ndarray) -> np.ndarray:
    """Which scenes of a world are kept for what they show: of the same event those of least ``chance``."""
    rare, told = np.zeros(len(labels), bool), collections.Counter()
    for k in np.argsort(chance):
        event = labels[k].event
        rare[k] = labels[k].rare and (event is None or told[event] < _SAME_EVENT)
        told[event] += 1
    return rare
