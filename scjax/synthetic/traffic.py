"""Traffic on a network: the intelligent driver model, signals, right of way, and zipper merging.

Everybody keeps to a lane. A connector is entered only by who holds it: it is granted in order of rank and distance,
while nobody holds a connector that crosses or joins it, while its light allows, and while there is room behind it.
Driver model: Treiber, Hennecke, Helbing, "Congested traffic states", Phys. Rev. E 62 (2000), eqs. 1-3.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Signal
from scjax.synthetic.signals import Timing
from scjax.synthetic.tracks import Tracks

DT = 0.5  # seconds
_ACCELERATION, _BRAKING, _COMFORTABLE, _HARDEST = 1.5, 2.0, 3.0, 6.0  # m/s^2
_HEADWAY, _STANDSTILL = 1.3, 2.0  # seconds, metres
_STOP_BEFORE = 1.2  # metres between bumper and stop line
_MERGE = 60.0  # metres before a joint within which lanes take turns
_NONE = -1


@dataclasses.dataclass
class Fleet:
    """Vehicles under way, arrays [vehicles]; ``lane`` is -1 for those that wait to enter the map.

    Attributes:
      at: middle of the box along the lane [m]; speed [m/s]; after: lane that comes next, -1 at the edge of the map;
        holds: connector that is granted; sizes: length, width, height [m]; pace: share of the limit; aside: to the
        left of the centreline [m].
    """

    lane: Int[np.ndarray, " n"]
    at: Float64[np.ndarray, " n"]
    speed: Float64[np.ndarray, " n"]
    after: Int[np.ndarray, " n"]
    holds: Int[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    pace: Float64[np.ndarray, " n"]
    aside: Float64[np.ndarray, " n"]


class Simulation:
    """Vehicles on ``tracks`` under the lights of ``timings``, from ``time`` 0 on."""

    def __init__(self, tracks: Tracks, timings: list[Timing], fleet: Fleet, rng: np.random.Generator):
        self.tracks, self.timings, self.fleet, self.rng = tracks, timings, fleet, rng
        self.time = 0.0
        self._held = np.zeros(len(tracks.length), int)  # by how many each connector is held
        self._lights = np.full(len(tracks.length), int(Signal.UNKNOWN))
        self._show()

    @property
    def lights(self) -> Int[np.ndarray, " lanes"]:
        """``Signal`` of every lane now."""
        return self._lights

    def run(self, seconds: float) -> None:
        """Lets that much time pass."""
        for _ in range(round(seconds / DT)):
            self._step()

    def _step(self) -> None:
        fleet, tracks = self.fleet, self.tracks
        on = np.flatnonzero(fleet.lane >= 0)
        order = on[np.lexsort((fleet.at[on], fleet.lane[on]))]
        lane, at, speed, half = fleet.lane[order], fleet.at[order], fleet.speed[order], fleet.sizes[order, 0] / 2
        after = fleet.after[order]
        left = tracks.length[lane] - at
        tail = np.full(len(tracks.length), _NONE)
        tail[lane[::-1]] = np.arange(len(order))[::-1]
        gap, ahead = self._leaders(lane, at, half, after, left, tail)
        self._grant(order, lane, after, left, speed, half, tail)
        stopped = (after >= 0) & (tracks.junction[after] >= 0) & (fleet.holds[order] != after)
        wall = np.where(stopped, left - half - _STOP_BEFORE, np.inf)
        slower = np.where(ahead >= 0, speed[ahead], 0.0)
        # Whoever comes too late to stop comfortably was granted the way or is on it already.
        gaps = np.stack([gap, wall])
        closing = np.stack([speed - slower, speed])
        wanted = _STANDSTILL * np.array([[1.0], [0.25]]) + np.maximum(
            0.0, speed * np.array([[_HEADWAY], [0.0]]) + speed * closing / (2 * np.sqrt(_ACCELERATION * _BRAKING))
        )
        interaction = (wanted / np.maximum(gaps, 0.1)).max(0) ** 2
        limit = tracks.speed[lane] * fleet.pace[order]
        coming = np.where(after >= 0, tracks.speed[after] * fleet.pace[order], limit)
        limit = np.minimum(limit, np.sqrt(coming**2 + 2 * _BRAKING * 0.75 * np.maximum(left, 0.0)))
        change = _ACCELERATION * (1 - (speed / limit) ** 4 - interaction)
        new = np.maximum(0.0, speed + DT * np.clip(change, -_HARDEST, _ACCELERATION))
        new = np.minimum(new, np.maximum(limit, speed))  # however slow somebody wants to be
        move = np.minimum((speed + new) / 2 * DT, np.maximum(gaps.min(0) - 0.3, 0.0))
        new = np.minimum(new, np.maximum(2 * move / DT - speed, 0.0) + 2.0 * (move > 0))
        fleet.at[order], fleet.speed[order] = at + move, new
        self._advance(order)
        self.time += DT
        self._show()
        self._enter()

    def _leaders(self, lane, at, half, after, left, tail) -> tuple[np.ndarray, np.ndarray]:
        """Free metres before each vehicle (sorted by lane and place) and who ends them, -1 for nobody."""
        tracks, count = self.tracks, len(lane)
        rows = np.arange(count)
        ahead = np.full(count, _NONE)
        gap = np.full(count, np.inf)
        follows = np.append(lane[1:] == lane[:-1], False) if count else np.zeros(0, bool)
        ahead[follows] = rows[follows] + 1
        gap[follows] = (at[1:] - at[:-1])[follows[:-1]]

        def consider(who: np.ndarray, other: np.ndarray, distance: np.ndarray) -> None:
            better = (other >= 0) & (distance < gap[who])
            gap[who[better]], ahead[who[better]] = distance[better], other[better]

        front = rows[~follows & (after >= 0)]
        first = tail[after[front]]
        consider(front, first, left[front] + at[first])
        then = tracks.successors[after[front], 0]
        second = np.where((first < 0) & (then >= 0), tail[then], _NONE)
        consider(front, second, left[front] + tracks.length[after[front]] + at[second])
        # Those who have just left the same lane by another connector may still be in the way.
        parting = np.full(len(tracks.length), _NONE)
        young = rows[(tracks.entry[lane] >= 0) & (at - half < 4.0)]
        young = young[np.argsort(-at[young], kind="stable")]
        parting[tracks.entry[lane[young]]] = young
        other = parting[lane[front]]
        consider(front, other, left[front] + at[other])
        # Lanes that join: everyone follows who is next nearer to the joint.
        joining = rows[(after >= 0) & tracks.shared[after] & (left < _MERGE)]
        joining = joining[np.lexsort((left[joining], after[joining]))]
        near, far = joining[:-1], joining[1:]
        same = after[near] == after[far]
        consider(far[same], near[same], (left[far] - left[near])[same])
        gap -= half + np.where(ahead >= 0, half[ahead], 0.0)
        return gap, ahead

    def _grant(self, order, lane, after, left, speed, half, tail) -> None:
        """Hands out connectors to those who come near them, those of low rank and near ones first."""
        fleet, tracks = self.fleet, self.tracks
        self._take_back(order, lane, after, left, speed, half)
        reach = speed**2 / (2 * _BRAKING) + 2.5 * speed + 6.0
        asks = (after >= 0) & (tracks.junction[after] >= 0) & (fleet.holds[order] != after) & (left - half < reach)
        asking = np.flatnonzero(asks)
        if not len(asking):
            return
        asking = asking[np.lexsort((left[asking], tracks.rank[after[asking]]))]
        denied: set[int] = set()
        # Who waits further ahead in a lane comes first there, whatever the turn.
        waiting = {}
        for row in asking:
            waiting.setdefault(lane[row], []).append(left[row])
        for row in asking:
            here, way = lane[row], after[row]
            if here in denied or left[row] > min(waiting[here]) + 1e-6:
                denied.add(here)
                continue
            light = self._lights[way]
            late = speed[row] ** 2 / (2 * _COMFORTABLE) > left[row] - half[row] - _STOP_BEFORE
            allowed = light in (Signal.UNKNOWN, Signal.GO) or (light == Signal.CAUTION and late)
            then = tracks.successors[way, 0]
            last = tail[then] if then >= 0 else _NONE
            room = last < 0 or fleet.speed[order[last]] > 2.0
            room = room or fleet.at[order[last]] - half[last] > 2 * half[row] + 2.0 + 6.0 * self._held[way]
            if allowed and room and not self._held[tracks.conflict[way]].any():
                if (before := fleet.holds[order[row]]) >= 0:  # a short road between two junctions
                    self._held[before] -= 1
                fleet.holds[order[row]] = way
                self._held[way] += 1
                waiting[here].remove(left[row])
                if not waiting[here]:
                    waiting[here].append(np.inf)
            else:
                denied.add(here)

    def _take_back(self, order, lane, after, left, speed, half) -> None:
        """Whose light has turned yellow or red, and who can still stop, may not go any more."""
        fleet = self.fleet
        off = np.isin(self._lights[after], (Signal.CAUTION, Signal.STOP)) & (after >= 0)
        can_stop = left - half - _STOP_BEFORE > speed**2 / (2 * _COMFORTABLE)
        back = order[(fleet.holds[order] == after) & (lane != after) & off & can_stop]
        np.subtract.at(self._held, fleet.holds[back], 1)
        fleet.holds[back] = _NONE

    def _advance(self, order: np.ndarray) -> None:
        """On to the next lane, off the map; connectors that are left are free again."""
        fleet, tracks = self.fleet, self.tracks
        over = order[fleet.at[order] >= tracks.length[fleet.lane[order]]]
        gone = over[fleet.after[over] < 0]
        over = over[fleet.after[over] >= 0]
        fleet.at[over] -= tracks.length[fleet.lane[over]]
        fleet.lane[over] = fleet.after[over]
        fleet.after[over] = tracks.after(fleet.lane[over], self.rng.random(len(over)))
        held = np.flatnonzero(fleet.holds >= 0)
        past = (fleet.lane[held] != fleet.holds[held]) & (fleet.after[held] != fleet.holds[held])
        past &= fleet.at[held] - fleet.sizes[held, 0] / 2 > 0.5
        free = np.concatenate([held[past], gone[fleet.holds[gone] >= 0]])
        np.subtract.at(self._held, fleet.holds[free], 1)
        fleet.holds[free] = _NONE
        fleet.lane[gone] = _NONE

    def _enter(self) -> None:
        """Those who left the map come back by lanes that have room."""
        fleet, tracks = self.fleet, self.tracks
        waiting = np.flatnonzero(fleet.lane < 0)
        if not len(waiting) or not len(tracks.sources):
            return
        rear = np.full(len(tracks.length), np.inf)
        on = np.flatnonzero(fleet.lane >= 0)
        np.minimum.at(rear, fleet.lane[on], fleet.at[on] - fleet.sizes[on, 0] / 2)
        for who in waiting[:3]:
            lane = int(self.rng.choice(tracks.sources))
            speed = 0.8 * tracks.speed[lane] * fleet.pace[who]
            if rear[lane] > fleet.sizes[who, 0] + 4.0 + 1.5 * speed:
                fleet.lane[who], fleet.at[who], fleet.speed[who] = lane, fleet.sizes[who, 0] / 2, speed
                fleet.after[who] = tracks.after(np.array([lane]), self.rng.random(1))[0]
                rear[lane] = 0.0

    def _show(self) -> None:
        for timing in self.timings:
            for lane, state in timing.states(self.time).items():
                self._lights[lane] = int(state)


def fill(tracks: Tracks, density: Float64[np.ndarray, " lanes"], sizes, rng: np.random.Generator) -> Fleet:
    """A fleet spread over lanes that are no connectors, ``density`` vehicles a metre.

    Args:
      sizes: function (count) -> lengths, widths, heights [count, 3].
    """
    number = rng.poisson(density * tracks.length * (tracks.junction < 0))
    lane = np.repeat(np.arange(len(number)), number)
    box = sizes(len(lane))
    # Cut the lane into equal slots and drop those that are too short for a vehicle and its headway.
    rank = np.arange(len(lane)) - np.repeat(np.cumsum(number) - number, number)
    slot = tracks.length[lane] / number[lane]
    at = (rank + rng.uniform(0.25, 0.75, len(lane))) * slot
    fits = slot > 2 * box[:, 0] + 3.0
    lane, at, box, slot = lane[fits], at[fits], box[fits], slot[fits]
    pace = np.clip(rng.normal(1.05, 0.12, len(lane)), 0.7, 1.35)
    speed = np.minimum(tracks.speed[lane] * pace, np.maximum((slot - box[:, 0]) / 2.5, 0.0))
    after = tracks.after(lane, rng.random(len(lane)))
    # Most keep to the middle; some change lanes, turn wide, or make room.
    spread = np.where(rng.random(len(lane)) < 0.3, 0.6, 0.22)
    aside = np.clip(spread * rng.normal(size=len(lane)), -1.4, 1.4)
    return Fleet(lane, at, speed, after, np.full(len(lane), _NONE), box, pace, aside)
