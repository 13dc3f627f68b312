"""Builder of scenes by hand: roads, intersections with all their connectors, agents."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType, Link, Scene, Signal, empty, validate

WIDTH = 3.5
CAR = (4.5, 2.0, 1.6)


class SceneBuilder:
    """Collects lanes and agents; the ego is at the origin facing +x and drives with ``speed`` [m/s]."""

    def __init__(self, speed: float = 8.0):
        self.lanes, self.links, self.signals = [], [], {}
        self.agents, self.types = [], []
        self.add_agent(0, 0, 0, speed)

    def add_agent(self, x, y, heading=0.0, speed=0.0, agent_type=AgentType.VEHICLE):
        """An agent at (x, y) [m] with heading [degrees] and speed [m/s]; returns the builder."""
        turn = np.deg2rad(heading)
        size = CAR if agent_type == AgentType.VEHICLE else (0.6, 0.6, 1.7)
        self.agents.append([x, y, size[2] / 2, speed, np.cos(turn), np.sin(turn), *size])
        self.types.append(int(agent_type))
        return self

    def add_lane(self, *points, z=0.0):
        """A lane through points (x, y) [m]; returns its index."""
        points = np.array(points, float)
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        at = np.linspace(0, arc[-1], 20)
        xy = [np.interp(at, arc, points[:, k]) for k in (0, 1)]
        self.lanes.append(np.stack([*xy, np.full(20, z)], -1))
        return len(self.lanes) - 1

    def add_connector(self, start, heading, end, heading_end, z=0.0):
        """A smooth lane between two positions [m] and headings [degrees]; returns its index."""
        a, b = np.array(start, float), np.array(end, float)
        reach = 0.5 * np.linalg.norm(b - a)
        u, v = (np.array([np.cos(np.deg2rad(h)), np.sin(np.deg2rad(h))]) for h in (heading, heading_end))
        t = np.linspace(0, 1, 60)[:, None]
        controls = a, a + reach * u, b - reach * v, b
        weights = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3
        return self.add_lane(*sum(w * c for w, c in zip(weights, controls, strict=True)), z=z)

    def link(self, *pairs):
        """Pairs (lane, successor); returns the builder."""
        self.links += pairs
        return self

    def add_road(self, same=1, opposite=1, gap=0.0, start=-32.0, end=32.0, ego_index=1):
        """Straight lanes along x; the ego drives in the ``ego_index``-th lane from the left.

        Returns:
          Indices of the lanes with the ego's direction, and of the lanes opposite_direction it.
        """
        left = (ego_index - 1) * WIDTH
        same_direction = [self.add_lane((start, left - k * WIDTH), (end, left - k * WIDTH)) for k in range(same)]
        first = left + WIDTH + gap
        opposite_direction = [
            self.add_lane((end, first + k * WIDTH), (start, first + k * WIDTH)) for k in range(opposite)
        ]
        return same_direction, opposite_direction

    def add_intersection(self, center, arms, lanes=1, size=10.0, reach=45.0):
        """Roads that meet in ``center``, with every connector; traffic keeps right. Returns the builder.

        Args:
          arms: directions of the roads [degrees].
          lanes: per direction.
          size, reach: from the center to the start and to the end of the roads [m].
        """
        center, entering, leaving = np.array(center, float), [], []
        for arm in arms:
            out = np.array([np.cos(np.deg2rad(arm)), np.sin(np.deg2rad(arm))])
            right = np.array([out[1], -out[0]])
            for k in range(lanes):
                shift = (k + 0.5) * WIDTH * right
                leaving.append((arm, self.add_lane(center + size * out + shift, center + reach * out + shift)))
                entering.append((arm, self.add_lane(center + reach * out - shift, center + size * out - shift)))
        for arm, lane in entering:
            for exit_arm, exit_lane in leaving:
                if exit_arm != arm:
                    start, end = self.lanes[lane][-1, :2], self.lanes[exit_lane][0, :2]
                    connector = self.add_connector(start, arm + 180, end, exit_arm)
                    self.link((lane, connector), (connector, exit_lane))
        return self

    def scene(self) -> Scene:
        """The scene within the window of 64 m; lanes end at its border."""
        inside = [np.abs(line[:, :2]).max(1) <= 32.0 for line in self.lanes]
        rows = {k: n for n, k in enumerate(k for k, keep in enumerate(inside) if keep.sum() >= 3)}
        scene = empty(len(self.agents), len(rows))
        for k, n in rows.items():
            scene.lanes[n] = _resample(self.lanes[k][inside[k]])
            scene.signals[n] = self.signals.get(k, Signal.UNKNOWN)
        np.fill_diagonal(scene.links, Link.SELF)
        for i, j in self.links:
            if i in rows and j in rows and inside[i][-1] and inside[j][0]:
                scene.links[rows[i], rows[j]], scene.links[rows[j], rows[i]] = Link.PREDECESSOR, Link.SUCCESSOR
        return validate(
            scene.replace(
                agents=np.array(self.agents, np.float32),
                agent_types=np.array(self.types, np.int32),
                agent_mask=np.ones(len(self.agents), bool),
                agent_known=np.ones((len(self.agents), 9), bool),
                lane_mask=np.ones(len(rows), bool),
                lane_known=np.ones((len(rows), 3), bool),
            )
        )


def _resample(line):
    at = np.linspace(0, len(line) - 1, 20)
    return np.stack([np.interp(at, np.arange(len(line)), line[:, k]) for k in range(3)], -1).astype(np.float32)
