"""Registration of two sets of lane points by a small rigid motion in the plane (iterative closest point, ICP)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

LARGEST_SHIFT = 4.0  # metres; training shifts ego poses by up to 2 m along x and y (data.loader.PipelineConfig)
LARGEST_TURN = np.deg2rad(15.0)  # training turns them by up to 10 degrees
Pose = Float64[np.ndarray, " 3"]  # x, y [m] and yaw [rad]


def transform_points(points: Float[np.ndarray, "points columns"], pose: Pose) -> Float64[np.ndarray, "points columns"]:
    """Rotates points by yaw, then shifts them; columns after x, y are vectors in the plane (two columns each)."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    turned = (np.asarray(points, np.float64).reshape(len(points), points.shape[1] // 2, 2) @ turn).reshape(points.shape)
    turned[:, :2] += pose[:2]
    return turned


def register(
    points: Float[np.ndarray, "points 4"], target: Float[np.ndarray, "targets 4"], start: Pose, steps: int
) -> Pose:
    """A pose near ``start`` that moves ``points`` onto ``target``, within the largest shift and turn.

    Each of ``steps`` iterations pairs every point of either set with the nearest of the other, in all four columns, and
    solves for the rigid motion of these pairs in closed form (2-D Procrustes). Both sets have the same weight.
    """
    pose = start
    source = np.asarray(points, np.float64)
    goal = np.asarray(target, np.float64)
    weight = np.concatenate([np.full(len(source), 0.5 / len(source)), np.full(len(goal), 0.5 / len(goal))])
    for _ in range(steps):
        square = squared_distances(transform_points(source, pose), goal)
        first = np.concatenate([source, source[square.argmin(0)]])[:, :2]
        second = np.concatenate([goal[square.argmin(1)], goal])[:, :2]
        middle, there = weight @ first, weight @ second
        cross = (weight[:, None] * (first - middle)).T @ (second - there)
        yaw = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
        yaw = float(np.clip(yaw, -LARGEST_TURN, LARGEST_TURN))
        cos, sin = np.cos(yaw), np.sin(yaw)
        shift = there - np.array([cos * middle[0] - sin * middle[1], sin * middle[0] + cos * middle[1]])
        shift *= min(1.0, LARGEST_SHIFT / max(float(np.hypot(*shift)), 1e-9))
        pose = np.array([*shift, yaw])
    return pose


def squared_distances(
    first: Float[np.ndarray, "first 4"], second: Float[np.ndarray, "second 4"]
) -> Float[np.ndarray, "first second"]:
    """Squared distances of all pairs [m^2], by one matrix product (with its rounding)."""
    return (first**2).sum(-1)[:, None] + (second**2).sum(-1)[None] - 2 * (first @ second.T)
