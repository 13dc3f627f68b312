"""Synthetic worlds as a source of records: ``build(Worlds(seed, count), out)``."""

from __future__ import annotations

import collections
import dataclasses
import hashlib

import numpy as np

from scjax.data.build_options import BuildOptions
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.ranges import MAX_COUNT, check_number, check_seed
from scjax.data.readers.base import LogInfo
from scjax.data.record_source import PosedLog
from scjax.data.tiles import pose_of
from scjax.language.analysis.rare_events import EVENTS
from scjax.synthetic.domains import draw_domain
from scjax.synthetic.labels import SceneLabel, label_scene
from scjax.synthetic.recording import object_index, to_log
from scjax.synthetic.setting import VERSION
from scjax.synthetic.world import make_world

_MAX_SCENES_PER_EVENT = 2  # of a world, since many vehicles see the same jam


@dataclasses.dataclass(frozen=True)
class Worlds:
    """Worlds 0 .. ``count`` - 1 of ``seed``; each is a location of its own, with poses at its egos.

    Attributes:
      seed: of all worlds.
      count: number of worlds.
      ordinary: share of the scenes without anything rare (``SceneLabel.rare``) that is kept. The third and further
        scenes of one event in a world count as ordinary. A share below 1 makes rare things frequent.
      events: names of events; every world with a place for it shows one of them. A name given twice is drawn twice as
        often. Empty: any event in some of the worlds.

    Raises:
      ValueError: if ``count``, ``seed`` or ``ordinary`` is out of its range, or an event unknown.
    """

    seed: int
    count: int
    ordinary: float = 1.0
    events: tuple[str, ...] = ()

    def __post_init__(self):
        check_number("ordinary", self.ordinary, 0, 1, "give a share from 0 to 1", whole=False)
        if unknown := set(self.events) - set(EVENTS):
            raise ValueError(f"events has the unknown event {min(unknown)!r}: choose of {', '.join(EVENTS)}")
        check_number("the number of worlds", self.count, 1, MAX_COUNT, f"give at least one world, {MAX_COUNT} at most")
        check_seed(self.seed)

    def names(self) -> list[str]:
        """``seed/k`` of every world."""
        return [f"{self.seed}/{k:07d}" for k in range(self.count)]

    def scan(self, name: str) -> LogInfo:
        """Domain of a world, and a hash of all that its records depend on; does not build the world."""
        seed, k = _numbers(name)
        domain = draw_domain(np.random.default_rng([VERSION, seed, k])).name
        options = " ".join([f"{self.ordinary:g} {_MAX_SCENES_PER_EVENT}", *self.events])
        digest = hashlib.sha256(f"synthetic world {VERSION} {name} {options}".encode()).hexdigest()
        return LogInfo(name, digest, domain, name)

    def load(self, item: LogInfo, options: BuildOptions, dense: bool) -> PosedLog:
        """Builds the world; ``options`` and ``dense`` have no effect."""
        del options, dense
        seed, k = _numbers(item.file)
        world = make_world(seed, k, self.events)
        log = to_log(world)
        graph = build_graph(log, split_at_signals=True, signals_alone=True, bends_alone=True)
        index = index_segments(graph)
        uniform = np.random.default_rng([VERSION, seed, k, 1]).random(len(world.egos))
        labels = [label_scene(world, ego) for ego in world.egos]
        rows = np.flatnonzero((uniform < self.ordinary) | _is_rare(labels, uniform))
        egos = [world.egos[row] for row in rows]
        poses = [pose_of(log, index, ego.moment, object_index(world, ego.moment, ego.agent)) for ego in egos]
        kept_labels = [labels[row].to_json() for row in rows]
        return PosedLog(log, graph, index, poses, len(poses), kept_labels, keep_parked=True)


def _numbers(name: str) -> tuple[int, int]:
    """Seed and number of the world ``name``."""
    seed, k = name.split("/")
    return int(seed), int(k)


def _is_rare(labels: list[SceneLabel], uniform: np.ndarray) -> np.ndarray:
    """Which scenes of a world are kept as rare [scenes]; of one event those with the smallest ``uniform``."""
    is_rare, num_scenes = np.zeros(len(labels), bool), collections.Counter()
    for k in np.argsort(uniform):
        event = labels[k].event
        is_rare[k] = labels[k].rare and (event is None or num_scenes[event] < _MAX_SCENES_PER_EVENT)
        num_scenes[event] += 1
    return is_rare
