"""Space that a picture shows to be empty, from the tokens of the vision network of the package.

A vehicle that stood there would be seen: the cells that its box covers show something that is not nearer. Vehicles that
a network puts there go to the nearest place of a lane that is out of sight, also where cells show objects that are too
few to be a seen agent: such vehicles stood on empty road more often than in the place of another one.

A vehicle also hides the ground behind its lower half. Where cells show ground there, it does not stand.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.camera.dashcam.materials import SemanticClass
from scjax.camera.projection import project_points
from scjax.camera.standard_view import standard_camera
from scjax.encoders.dashcam_network import FINE, cells_of_tokens
from scjax.scene import AgentType, Scene
from scjax.scene.boxes import overlaps
from scjax.scene.edit import keep_elements

_REACH = 42.0  # m ahead, to which agents are seen
_INSIDE = 0.3  # share of a box in the picture, at least
_OUTSIDE = 0.1  # the same of a box that is out of sight, at most
_HIDDEN = 0.9  # share of a box behind something nearer, of one that may be there
_DEPTH_SHARE, _DEPTH_ERROR = 0.15, 1.0  # of the depth of a cell, and m
_ACROSS = np.linspace(0.0, 1.0, 7)[1:-1]  # points of a box's silhouette
_UP, _LOWER = (0.1, 0.35, 0.6, 0.85), (0.05, 0.2, 0.35)  # shares of a box's height; of its lower half
_GROUND = 0.95  # share of the lower half that shows ground, at most
_GROUND_CLASSES = [SemanticClass.TERRAIN, SemanticClass.SIDEWALK, SemanticClass.ROAD, SemanticClass.MARKING]
_GAP = 2.0  # m before and behind a vehicle that is moved

Cells = tuple[np.ndarray, np.ndarray]  # rows and columns


@dataclasses.dataclass(frozen=True)
class SeenSpace:
    """What the fine cells of a standard view show.

    Attributes:
      depth: of what they show [m].
      ground: how sure it is that this is ground, from 0 to 1.
    """

    depth: Float64[np.ndarray, "rows columns"]
    ground: Float64[np.ndarray, "rows columns"]

    @classmethod
    def of_cells(cls, cells: Float[np.ndarray, "width rows columns"]) -> SeenSpace:
        """From the tokens of a picture in their places."""
        rows, columns = cells.shape[1:]
        fine = cells_of_tokens(cells.reshape(len(cells), -1).T.astype(np.float64))
        shares = np.exp(fine["classes"] - fine["classes"].max(-1, keepdims=True))
        ground = shares[:, _GROUND_CLASSES].sum(-1) / shares.sum(-1)

        def in_place(values: np.ndarray) -> np.ndarray:
            return values.reshape(rows, columns, FINE, FINE).swapaxes(1, 2).reshape(rows * FINE, columns * FINE)

        return cls(in_place(np.exp(fine["depth"].clip(-5, 10))), in_place(ground))

    def shows_empty(self, agents: Float[np.ndarray, "agents 9"]) -> Bool[np.ndarray, " agents"]:
        """Boxes, in the frame of the ego as in a scene, that the picture would show if they were there."""
        return np.array([self._would_show(agent) for agent in np.asarray(agents, np.float64)], bool)

    def shows_ground(self, agents: Float[np.ndarray, "agents 9"]) -> Bool[np.ndarray, " agents"]:
        """Boxes, in the frame of the ego as in a scene, in whose lower half the picture shows ground."""
        covered = [self._covered(agent, _LOWER)[0] for agent in np.asarray(agents, np.float64)]
        return np.array([len(cells[0]) > 0 and self.ground[cells].mean() > _GROUND for cells in covered], bool)

    def hides(self, agent: Float64[np.ndarray, " 9"]) -> bool:
        """Whether a box lies out of sight: beside the picture, behind something, or too far away."""
        cells, depth, inside, reach = self._covered(agent)
        if reach > _REACH or inside < _OUTSIDE:
            return True
        return bool(self._are_hidden(cells, depth).mean() > _HIDDEN)

    def _would_show(self, agent: Float64[np.ndarray, " 9"]) -> bool:
        cells, depth, inside, reach = self._covered(agent)
        return reach <= _REACH and inside >= _INSIDE and bool(self._are_hidden(cells, depth).mean() <= _HIDDEN)

    def _covered(
        self, agent: Float64[np.ndarray, " 9"], up: Sequence[float] = _UP
    ) -> tuple[Cells, np.ndarray, float, float]:
        """Rows and columns of the cells of points of a box's silhouette, their depths, the share of the points that lie
        in the picture, and how far away the box is [m]."""
        camera = standard_camera()
        x, y, cos, sin = agent[[0, 1, 4, 5]]
        corners = np.array([[along, across] for along in (-0.5, 0.5) for across in (-0.5, 0.5)]) * agent[6:8]
        corners = corners @ np.array([[cos, sin], [-sin, cos]]) + [x, y] - camera.translation[:2]
        angles, distances = np.arctan2(corners[:, 1], corners[:, 0]), np.hypot(*corners.T)
        reach = max(float(np.sort(distances)[:2].mean()), 1.0)
        across, up = (
            part.ravel() for part in np.meshgrid(angles.min() + _ACROSS * np.ptp(angles), np.multiply(up, agent[8]))
        )
        points = np.stack([reach * np.cos(across), reach * np.sin(across), up - camera.translation[2]], -1)
        image = project_points(camera, points @ camera.rotation)
        size = camera.width, camera.height
        inside = image.visible & (image.pixels >= 0).all(-1) & (image.pixels < size).all(-1)
        rows, columns = self.depth.shape
        column, row = (image.pixels[inside] * (columns / size[0], rows / size[1])).astype(int).T
        return (row, column), image.depth[inside], float(inside.mean()), reach

    def _are_hidden(self, cells: Cells, depth: np.ndarray) -> np.ndarray:
        """Which points lie behind what their cells show, and those beside them."""
        return self._farthest[cells] < (1 - _DEPTH_SHARE) * depth - _DEPTH_ERROR

    @functools.cached_property
    def _farthest(self) -> Float64[np.ndarray, "rows columns"]:
        """The greatest depth of each cell and those beside it: cells are too coarse for gaps between vehicles."""
        depth = np.pad(self.depth, ((0, 0), (1, 1)), mode="edge")
        return np.maximum(np.maximum(depth[:, :-2], depth[:, 2:]), self.depth)


def move_misplaced(scene: Scene, first: int, space: SeenSpace, keeps_number: bool) -> Scene:
    """The scene without vehicles where the picture shows that there is none, or inside the ego or agents that are seen.

    Each goes to the nearest place of a lane that is out of sight. Where there is no such place it is left out.

    Args:
      scene: single, unpadded, in the frame of the ego; its first agents are the ego and those that are seen.
      first: their number.
      keeps_number: whether vehicles without such a place stay where they are.
    """
    agents = np.asarray(scene.agents, np.float64).copy()
    misplaced = space.shows_empty(agents) | overlaps(agents)[:first].any(0)
    misplaced &= np.asarray(scene.agent_types) == AgentType.VEHICLE
    misplaced[:first] = False
    if not misplaced.any():
        return scene
    places, kept = _lane_places(scene), ~misplaced
    for row in np.flatnonzero(misplaced):
        order = np.argsort(np.hypot(*(places[:, :2] - agents[row, :2]).T), kind="stable")
        for place in places[order]:
            box = agents[row].copy()
            box[[0, 1, 4, 5]], box[2] = place[[0, 1, 3, 4]], place[2] + box[8] / 2
            longer = box.copy()
            longer[6] += 2 * _GAP
            if not space.hides(box) or overlaps(np.stack([longer, *agents[kept]]))[0].any():
                continue
            agents[row], kept[row] = box, True
            break
        kept[row] |= keeps_number
    scene = scene.replace(agents=agents.astype(scene.agents.dtype))
    return keep_elements(scene, kept, np.ones(len(scene.lanes), bool))


def _lane_places(scene: Scene) -> Float64[np.ndarray, "places 5"]:
    """Middles between the points of all lanes: x, y, z, cosine and sine of the direction."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask)]
    steps, middles = lanes[:, 1:] - lanes[:, :-1], (lanes[:, 1:] + lanes[:, :-1]) / 2
    lengths = np.maximum(np.linalg.norm(steps[..., :2], axis=-1, keepdims=True), 1e-6)
    return np.concatenate([middles, steps[..., :2] / lengths], -1).reshape(-1, 5)
