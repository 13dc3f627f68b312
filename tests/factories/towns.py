"""Scenes drawn by hand for the captioner: roads, intersections with all their connectors, rings, cars on lanes."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType, Link, Scene, Signal, empty, validate

WIDTH = 3.5
CAR = (4.5, 2.0, 1.6)


class Town:
    """Collects lanes and agents; the ego is at the origin facing +x."""

    def __init__(self, speed: float = 8.0):
        self.lanes, self.joins, self.signals = [], [], {}
        self.agents, self.types = [], []
        self.agent(0, 0, 0, speed)

    def agent(self, x, y, heading=0.0, speed=0.0, kind=AgentType.VEHICLE):
        turn = np.deg2rad(heading)
        size = CAR if kind == AgentType.VEHICLE else (0.6, 0.6, 1.7)
        self.agents.append([x, y, size[2] / 2, speed, np.cos(turn), np.sin(turn), *size])
        self.types.append(int(kind))
        return self

    def line(self, *points, z=0.0):
        """A lane through points [x, y]; returns its number."""
        points = np.array(points, float)
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        at = np.linspace(0, arc[-1], 20)
        xy = [np.interp(at, arc, points[:, k]) for k in (0, 1)]
        self.lanes.append(np.stack([*xy, np.full(20, z)], -1))
        return len(self.lanes) - 1

    def bow(self, start, heading, end, heading_end, z=0.0):
        """A smooth lane between two places and headings (degrees)."""
        a, b = np.array(start, float), np.array(end, float)
        reach = 0.5 * np.linalg.norm(b - a)
        u, v = (np.array([np.cos(np.deg2rad(h)), np.sin(np.deg2rad(h))]) for h in (heading, heading_end))
        t = np.linspace(0, 1, 60)[:, None]
        controls = a, a + reach * u, b - reach * v, b
        weights = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3
        return self.line(*sum(w * c for w, c in zip(weights, controls, strict=True)), z=z)

    def join(self, *pairs):
        self.joins += pairs
        return self

    def road(self, same=1, opposite=1, gap=0.0, start=-32.0, end=32.0, ego_index=1):
        """Straight lanes along x; the ego's lane is the ``ego_index``-th from the left. Returns both directions."""
        left = (ego_index - 1) * WIDTH
        with_it = [self.line((start, left - k * WIDTH), (end, left - k * WIDTH)) for k in range(same)]
        first = left + WIDTH + gap
        against = [self.line((end, first + k * WIDTH), (start, first + k * WIDTH)) for k in range(opposite)]
        return with_it, against

    def crossing(self, centre, arms, lanes=1, size=10.0, reach=45.0, oneway=()):
        """Roads that meet in ``centre``: arms by direction in degrees, ``lanes`` each way, with every connector.

        Traffic keeps right; an arm in ``oneway`` only leads away.
        """
        centre, entering, leaving = np.array(centre, float), [], []
        for arm in arms:
            out = np.array([np.cos(np.deg2rad(arm)), np.sin(np.deg2rad(arm))])
            right = np.array([out[1], -out[0]])
            for k in range(lanes):
                shift = (k + 0.5) * WIDTH * right
                leaving.append((arm, self.line(centre + size * out + shift, centre + reach * out + shift)))
                if arm not in oneway:
                    entering.append((arm, self.line(centre + reach * out - shift, centre + size * out - shift)))
        for arm, lane in entering:
            for other, after in leaving:
                if other != arm:
                    start, end = self.lanes[lane][-1, :2], self.lanes[after][0, :2]
                    self.join((lane, c := self.bow(start, arm + 180, end, other)), (c, after))
        return self

    def scene(self) -> Scene:
        """What lies within the window; lanes are cut where they leave it."""
        inside = [np.abs(line[:, :2]).max(1) <= 32.0 for line in self.lanes]
        rows = {k: n for n, k in enumerate(k for k, keep in enumerate(inside) if keep.sum() >= 3)}
        made = empty(len(self.agents), len(rows))
        for k, n in rows.items():
            made.lanes[n] = _stretched(self.lanes[k][inside[k]])
            made.signals[n] = self.signals.get(k, Signal.UNKNOWN)
        np.fill_diagonal(made.links, Link.SELF)
        for i, j in self.joins:
            if i in rows and j in rows and inside[i][-1] and inside[j][0]:
                made.links[rows[i], rows[j]], made.links[rows[j], rows[i]] = Link.PREDECESSOR, Link.SUCCESSOR
        return validate(
            made.replace(
                agents=np.array(self.agents, np.float32), agent_types=np.array(self.types, np.int32),
                agent_mask=np.ones(len(self.agents), bool), agent_known=np.ones((len(self.agents), 9), bool),
                lane_mask=np.ones(len(rows), bool), lane_known=np.ones((len(rows), 3), bool),
            )
        )  # fmt: skip


def _stretched(line):
    at = np.linspace(0, len(line) - 1, 20)
    return np.stack([np.interp(at, np.arange(len(line)), line[:, k]) for k in range(3)], -1).astype(np.float32)
