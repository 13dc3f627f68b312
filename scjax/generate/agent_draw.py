"""The agents of an outline, changed until their numbers and places fulfill a request as far as kinds can say."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from scjax.language.attributes.contradictions import least_numbers
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import agent_digits, digits_of
from scjax.scene import AgentType

Kinds = Int[np.ndarray, "_"]

_LARGE = "large"
_COUNTED = {
    "vehicles": AgentType.VEHICLE,
    "pedestrians": AgentType.PEDESTRIAN,
    "cyclists": AgentType.CYCLIST,
    "static": AgentType.STATIC,
}  # attributes that count agents of a class, besides the ego
_AHEAD, _BEHIND, _LEFT, _RIGHT = 1, 2, 3, 4  # sides of the ego
_ALONG = 1  # in the middle of a lane and along it
_ONWARD, _ACROSS, _AGAINST = (7, 0, 1), (2, 6), (4,)  # sectors of directions
_PART_OF = {
    **dict.fromkeys(("ahead", "behind", "left_lane", "right_lane", "oncoming", "crossing"), "vehicles"),
    **dict.fromkeys(("stopped", "parked"), "vehicles"),
    **dict.fromkeys(("pedestrians_on_road", "pedestrians_ahead"), "pedestrians"),
}
"""Part -> the number that it is a part of."""


class AgentDraw:
    """Draws of agents' kinds for a request in its normal form; those that a scene lacks come from ``outlines``."""

    def __init__(
        self,
        rng: np.random.Generator,
        outlines: Int[np.ndarray, "scenes agents"],
        codec: SceneCodec,
        request: Mapping[str, Any],
    ):
        self._request, self._least = request, least_numbers(request)
        self._rng, self._others, self._sizes = rng, outlines[:, 1:].ravel(), agent_digits(codec)
        self._classes = self._sizes[0]
        large = self._classes - 1
        self._classes_of = {
            name: [codec.agent_types.index(one)] if one in codec.agent_types else [] for name, one in _COUNTED.items()
        }
        self._classes_of["vehicles"].append(large)
        self._classes_of[_LARGE] = [large]

    def fit(self, kinds: Kinds, missed: Collection[str] = ()) -> Kinds:
        """Kinds whose numbers fulfill the request, its parts and events included.

        Args:
          missed: attributes that the scene of these kinds does not show: of those that count agents in one place,
            agents are exchanged for others.
        """
        for name in (_LARGE, *_COUNTED):
            _, high = self._request.get(name, (0, None))
            are_members = self._members(kinds, name)
            missing = int(self._least.get(name, 0)) - int(are_members.sum())
            if missing > 0:
                kinds = self._insert(kinds, name, missing)
            elif high is not None and are_members.sum() > high:
                kinds = self._leave_out(kinds, are_members, int(are_members.sum() - high))
        for name in missed:
            if name in _PART_OF:
                kinds = self._exchange(kinds, name)
        return kinds

    def replace(self, kinds: Kinds, known: Kinds) -> Kinds:
        """The kinds of known agents, the ego first, and the others without as many of the same classes."""
        for kind in known[1:]:
            same = np.flatnonzero(kinds[1:] % self._classes == kind % self._classes)
            if len(same):
                kinds = np.delete(kinds, 1 + self._rng.choice(same))
        return np.concatenate([known, kinds[1:]])

    def count_misses(self, kinds: Int[np.ndarray, "scenes agents"]) -> np.ndarray:
        """Of every scene, how many requested numbers of agents in one place its kinds do not show [scenes]."""
        misses = np.zeros(len(kinds), int)
        for name in _PART_OF:
            if name in self._request:
                least, most = self._request[name]
                number = self._members(kinds, name).sum(1)
                misses += (number < least) | (number > (np.inf if most is None else most))
        return misses

    def _members(self, kinds: Int[np.ndarray, "*n"], name: str) -> Bool[np.ndarray, "*n"]:
        """Agents of a class, or of a part of one, besides the ego."""
        are_members = (kinds >= 0) & np.isin(kinds % self._classes, self._classes_of[_PART_OF.get(name, name)])
        are_members[..., :1] = False
        return are_members & self._in_place(kinds, name) if name in _PART_OF else are_members

    def _in_place(self, kinds: Int[np.ndarray, "*n"], name: str) -> Bool[np.ndarray, "*n"]:
        """Whether agents are where, or as fast as, a part says."""
        _, speed, direction, lane, side, _ = digits_of(np.maximum(kinds, 0), self._sizes)
        onward = (lane == _ALONG) & np.isin(direction, _ONWARD)
        return {
            "ahead": onward & (side == _AHEAD),
            "behind": onward & (side == _BEHIND),
            "left_lane": onward & (side == _LEFT),
            "right_lane": onward & (side == _RIGHT),
            "oncoming": (lane == _ALONG) & np.isin(direction, _AGAINST),
            "crossing": np.isin(direction, _ACROSS) & ((speed > 0) | (lane > 0)),
            "stopped": speed == 0,
            "parked": (speed == 0) & (lane == 0),
            "pedestrians_on_road": lane > 0,
            "pedestrians_ahead": side == _AHEAD,
        }[name]

    def _requested_places(self, kinds: Kinds) -> Bool[np.ndarray, " _"]:
        """Agents that belong to any part of which the request says something."""
        places = [self._members(kinds, name) for name in _PART_OF if name in self._request]
        return np.any(places, axis=0) if places else np.zeros(len(kinds), bool)

    def _insert(self, kinds: Kinds, name: str, number: int) -> Kinds:
        """``number`` more agents of kinds that such agents have here or elsewhere, at random places.

        They are no part of what the request counts, if there are such kinds.
        """
        class_ = self._classes_of[name][:1]
        like = np.zeros(0, int)
        for pool in (kinds[1:], self._others):
            pool = pool[(pool >= 0) & np.isin(pool % self._classes, class_)]
            free = pool[~self._requested_places(np.append(-1, pool))[1:]]
            if len(free):
                return self._placed(kinds, self._rng.choice(free, number))
            like = like if len(like) else pool
        return self._placed(kinds, self._rng.choice(like, number)) if len(like) else kinds

    def _placed(self, kinds: Kinds, new: Kinds) -> Kinds:
        """With new agents, those ahead of the ego behind all others in order: the order is along x."""
        for kind in new:
            side = digits_of(kinds, self._sizes)[4]
            low, high = 1, len(kinds)
            own = int(digits_of(kind[None], self._sizes)[4][0])
            if own == _AHEAD:
                low = max([low, *(np.flatnonzero(side == _BEHIND) + 1)])
            elif own == _BEHIND:
                high = min([high, *np.flatnonzero(side[1:] == _AHEAD) + 1])
            kinds = np.insert(kinds, self._rng.integers(low, max(low, high) + 1), kind)
        return kinds

    def _leave_out(self, kinds: Kinds, are_members: np.ndarray, number: int) -> Kinds:
        """Without ``number`` members drawn at random: those last of which the request calls for some."""
        needed = np.zeros(len(kinds), int)
        for name in (_LARGE, *_PART_OF):
            if self._least.get(name, 0) and (name == _LARGE or name in self._request):
                needed += self._members(kinds, name)
            elif name in self._request and self._request[name][1] is not None:
                needed -= self._members(kinds, name)
        order = self._rng.permutation(np.flatnonzero(are_members))
        order = order[np.argsort(needed[order], kind="stable")]
        return np.delete(kinds, order[:number])

    def _exchange(self, kinds: Kinds, name: str) -> Kinds:
        """Agents that the request counts nowhere become some of a part that lacks them, surplus ones the reverse."""
        least, most = self._request[name]
        own, pool = self._members(kinds, name), np.append(-1, self._others[self._others >= 0])
        of_class = self._members(pool, _PART_OF[name])
        if own.sum() < least:
            number = int(least - own.sum())
            others = self._members(kinds, _PART_OF[name]) & ~self._members(kinds, _LARGE)
            leaving = np.flatnonzero(others & ~self._requested_places(kinds))
            pool = pool[self._members(pool, name) & ~self._members(pool, _LARGE)]
        elif most is not None and own.sum() > most:
            number, leaving = int(own.sum() - most), np.flatnonzero(own)
            pool = pool[of_class & ~self._requested_places(pool) & ~self._members(pool, _LARGE)]
        else:
            return kinds
        number = min(number, len(leaving))
        if not number or not len(pool):
            return kinds
        leaving = self._rng.permutation(leaving)[:number]
        return self._placed(np.delete(kinds, leaving), self._rng.choice(pool, number))
