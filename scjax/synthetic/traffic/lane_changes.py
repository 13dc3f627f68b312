"""Lane changes: for a better lane, where nobody behind has to brake.

After Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research
Record 1999 (2007): safety criterion and incentive, without politeness.
"""

from __future__ import annotations

import numpy as np

from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.traffic.driver_model import accelerate
from scjax.synthetic.traffic.fleet import Fleet
from scjax.synthetic.traffic.queue import TrafficQueue

_SAFE_DECELERATION = -1.5  # m/s^2 of the new follower
_INCENTIVE = 0.5  # m/s^2 gained
_SHARE = 0.3  # of the vehicles that would gain, at each decision
_GAP_AHEAD, _GAP_BEHIND = 6.0, 18.0  # m; who follows closer is cut off
_OLD_FOLLOWER_GAP = 8.0  # m to the vehicle behind in the old lane
_MIN_SPEED = 1.5  # m/s
_MARGIN = 25.0  # m to the ends of a lane
_LATERAL_SPEED = 1.1  # m/s


def change_lanes(
    fleet: Fleet,
    queue: TrafficQueue,
    lanes: LaneArrays,
    gap: np.ndarray,
    leader: np.ndarray,
    blocked: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Starts lane changes of some vehicles.

    Args:
      gap, leader: of every vehicle in the queue, as from ``find_leaders``.
      blocked: vehicles with an obstacle ahead in their lane, which have to leave it [vehicles on the map].
    """
    is_settled = np.abs(fleet.lateral_goal[queue.rows] - fleet.lateral[queue.rows]) < 0.3
    is_inside = (queue.along > _MARGIN) & (queue.remaining > _MARGIN)
    may_change = is_settled & is_inside & (lanes.junction[queue.lane] < 0)
    may_change &= (blocked | (rng.random(len(queue.rows)) < _SHARE)) & (blocked | (queue.speed > _MIN_SPEED))
    taken: set[tuple[int, int]] = set()
    for side in (lanes.left, lanes.right):
        target = np.where(may_change, side[queue.lane], -1)
        movers = np.flatnonzero(target >= 0)
        if not len(movers):
            continue
        along = queue.along[movers] * lanes.length[target[movers]] / lanes.length[queue.lane[movers]]
        behind, ahead = queue.neighbors_at(target[movers], along)
        gains = _gains(fleet, queue, lanes, movers, target[movers], along, behind, ahead, gap, leader)
        gains |= blocked[movers] & _is_free(queue, movers, along, behind, ahead, gap_behind=4.0)
        for mover, place, b, a in zip(movers[gains], along[gains], behind[gains], ahead[gains], strict=True):
            row, lane = queue.rows[mover], int(target[mover])
            if (lane, int(b)) in taken or fleet.lane[row] != queue.lane[mover]:
                continue
            taken.add((lane, int(b)))
            taken.add((lane, int(a)))
            start_change(fleet, lanes, int(row), lane, float(place), rng)


def start_change(
    fleet: Fleet, lanes: LaneArrays, row: int, lane: int, along: float, rng: np.random.Generator, seconds: float = 0.0
) -> None:
    """Puts vehicle ``row`` into the neighboring ``lane`` at ``along`` [m]; its offset keeps it where it is for now.

    Args:
      seconds: that the move takes; 0 for the usual speed.
    """
    rows = np.array([row])
    position, heading = lanes.poses_at(fleet.lane[rows], fleet.along[rows])
    left = np.array([-np.sin(heading[0]), np.cos(heading[0])])
    position = position[0] + fleet.lateral[row] * left
    target, target_heading = lanes.poses_at(np.array([lane]), np.array([along]))
    target_left = np.array([-np.sin(target_heading[0]), np.cos(target_heading[0])])
    offset = float((position - target[0]) @ target_left)
    fleet.lane[row], fleet.along[row], fleet.lateral[row] = lane, along, offset
    fleet.lateral_goal[row] = float(np.clip(fleet.lateral_goal[row], -0.4, 0.4))
    fleet.lateral_speed[row] = abs(offset) / seconds if seconds else _LATERAL_SPEED
    fleet.next_lane[row] = lanes.pick_successors(np.array([lane]), rng.random(1), fleet.sizes[rows, 0])[0]
    fleet.previous_lane[row] = lanes.predecessor[lane]


def _is_free(
    queue: TrafficQueue,
    movers: np.ndarray,
    along: np.ndarray,
    behind: np.ndarray,
    ahead: np.ndarray,
    gap_behind: float = _GAP_BEHIND,
) -> np.ndarray:
    """Whether there is room in the target lane [movers]."""
    half = queue.half_length
    room_ahead = np.where(ahead >= 0, queue.along[ahead] - along - half[ahead] - half[movers], np.inf)
    room_behind = np.where(behind >= 0, along - queue.along[behind] - half[behind] - half[movers], np.inf)
    return (room_ahead > _GAP_AHEAD) & (room_behind > gap_behind)


def _gains(
    fleet: Fleet,
    queue: TrafficQueue,
    lanes: LaneArrays,
    movers: np.ndarray,
    target: np.ndarray,
    along: np.ndarray,
    behind: np.ndarray,
    ahead: np.ndarray,
    gap: np.ndarray,
    leader: np.ndarray,
) -> np.ndarray:
    """Whether a change is safe and gives a better acceleration [movers]."""
    factor = fleet.speed_factor[queue.rows]
    speed, half = queue.speed, queue.half_length
    new_gap = np.where(ahead >= 0, queue.along[ahead] - along - half[ahead] - half[movers], np.inf)
    new_limit = lanes.speed[target] * factor[movers]
    new = accelerate(speed[movers], new_limit, new_gap, speed[movers] - np.where(ahead >= 0, speed[ahead], 0.0))
    limit = lanes.speed[queue.lane[movers]] * factor[movers]
    leaders = leader[movers]
    closing = speed[movers] - np.where(leaders >= 0, speed[leaders], 0.0)
    old = accelerate(speed[movers], limit, gap[movers], closing)
    follower_gap = np.where(behind >= 0, along - queue.along[behind] - half[behind] - half[movers], np.inf)
    follower_limit = lanes.speed[target] * factor[behind]
    follower = accelerate(speed[behind], follower_limit, follower_gap, speed[behind] - speed[movers])
    has_room_behind = _room_in_old_lane(queue, movers) > _OLD_FOLLOWER_GAP
    is_safe = (behind < 0) | (follower > _SAFE_DECELERATION)
    return (new > old + _INCENTIVE) & is_safe & has_room_behind & _is_free(queue, movers, along, behind, ahead)


def _room_in_old_lane(queue: TrafficQueue, movers: np.ndarray) -> np.ndarray:
    """Gaps to the vehicles behind in the same lane [m]."""
    follower = np.maximum(movers - 1, 0)
    is_follower = (movers > 0) & (queue.lane[follower] == queue.lane[movers])
    room = queue.along[movers] - queue.along[follower] - queue.half_length[movers] - queue.half_length[follower]
    return np.where(is_follower, room, np.inf)
