"""The request for a scene: counts, known elements, a domain, a crop, a prompt, and streams of condition tokens."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from scjax.camera.photo import as_photo
from scjax.encoders.depth import DepthProvider, ExactDepth
from scjax.encoders.text import clean_text
from scjax.encoders.vision import GridTokens
from scjax.generate.camera_stream import picture_camera
from scjax.generate.seen_views import CHANGES
from scjax.language.attributes.table import check_attributes
from scjax.scene import Crop, Scene, validate
from scjax.scene.arguments import truth_value, whole_number
from scjax.scene.limits import MAX_SLOTS

STREAMS = ("text", "negative_text", "image", "depth", "camera", "attributes")
"""Names of the streams that a condition may carry."""

_PROMPTS = {"text": "prompt", "negative_text": "negative_prompt"}  # stream -> the field that would fill it
_CAMERA = ("image", "depth")  # of a picture


@dataclasses.dataclass(frozen=True)
class Stream:
    """Condition tokens of one kind: of a text, of an image, of a depth map, of attributes.

    Attributes:
      tokens: [tokens, width] features.
      mask: [tokens] True at real tokens; None: all are real.
      positions: [tokens, axes] place of each token, such as (row, column) in an image; None: the order is the place.
      views: [changes, tokens, width] tokens of changed views of an image, which no network reads, but
        ``generate.seen_agents``; None: not known.
    """

    tokens: Array | np.ndarray
    mask: Array | np.ndarray | None = None
    positions: Array | np.ndarray | None = None
    views: Array | np.ndarray | None = None

    def __post_init__(self):
        tokens = _numbers(self.tokens, "Stream.tokens", finite=False)
        if tokens.ndim != 2 or not tokens.size:
            raise ValueError(
                f"Stream.tokens must be [tokens, width], at least one of each, not of shape {tokens.shape}"
            )
        for name, rank in (("mask", 1), ("positions", 2)):
            value = getattr(self, name)
            if value is None:
                continue
            array = _numbers(value, f"Stream.{name}")
            if array.ndim != rank or len(array) != len(tokens):
                raise ValueError(
                    f"Stream.{name} has shape {array.shape}, but there are {len(tokens)} tokens: give one entry for "
                    "each token"
                )
            if name == "mask" and array.dtype != bool:
                raise ValueError(f"Stream.mask must be of type bool, not {array.dtype}: True at real tokens")
        if self.views is not None:
            shape = _numbers(self.views, "Stream.views").shape
            if shape != (len(CHANGES), *tokens.shape):
                raise ValueError(
                    f"Stream.views has shape {shape}, but must be {(len(CHANGES), *tokens.shape)}: leave it out, or "
                    "give the picture itself as Condition.image"
                )
        real = tokens if self.mask is None else tokens[np.asarray(self.mask)]
        if not np.isfinite(real.astype(np.float32)).all():
            raise ValueError("Stream.tokens holds NaN or infinity: correct the features")

    @classmethod
    def from_image(cls, features: Array | np.ndarray) -> Stream:
        """One token for each cell of an image encoder's features [channels, rows, columns]."""
        shape = _numbers(features, "image features").shape
        if len(shape) != 3 or 0 in shape:
            raise ValueError(f"image features must be [channels, rows, columns], not of shape {shape}")
        channels, rows, columns = shape
        return cls(tokens=features.reshape(channels, -1).T, positions=_grid_positions(rows, columns))

    @classmethod
    def from_cells(cls, cells: GridTokens) -> Stream:
        """The tokens of a frozen encoder's grid, or of depth, with its mask."""
        return cls(tokens=cells.tokens, mask=cells.mask, positions=_grid_positions(*cells.grid))

    @classmethod
    def from_depth(cls, depth: Array | np.ndarray) -> Stream:
        """One token for each pixel of a depth map [height, width], scaled to 0..1."""
        shape = _numbers(depth, "a depth map").shape
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"a depth map must be [height, width], not of shape {shape}")
        return cls.from_image(depth[None])

    def grid(self) -> Float[Array | np.ndarray, "channels rows columns"]:
        """The features on their grid, the inverse of ``from_image``.

        Raises:
          ValueError: the positions are not those of a full grid in row-major order.
        """
        positions = None if self.positions is None else np.asarray(self.positions)
        if positions is None or positions.shape[1:] != (2,) or not len(positions):
            raise ValueError("this stream has no grid: make it with Stream.from_image or Stream.from_depth")
        rows, columns = (int(size) for size in positions.max(0) + 1)
        if not np.array_equal(positions, _grid_positions(rows, columns)):
            raise ValueError("the positions of this stream are no full grid: make it with Stream.from_image")
        return self.tokens.T.reshape(-1, rows, columns)

    def content_hash(self) -> bytes:
        """Equal for streams of equal content."""
        digest = hashlib.sha256()
        for value in (self.tokens, self.mask, self.positions, self.views):
            array = np.asarray(value) if value is not None else np.zeros(0)
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.digest()


def _numbers(value: Any, name: str, *, finite: bool = True) -> np.ndarray:
    """``value`` on the host; ValueError unless it is an array of numbers, by default of finite ones."""
    if isinstance(value, Tracer):
        raise ValueError(f"{name} is traced: make streams outside of jax.jit")
    if not isinstance(value, jax.Array | np.ndarray):
        raise ValueError(f"{name} must be an array, not {type(value).__name__}")
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" and array.dtype != jnp.bfloat16:
        raise ValueError(f"{name} must hold numbers, not {array.dtype}")
    if finite and not np.isfinite(array.astype(np.float32)).all():
        raise ValueError(f"{name} holds NaN or infinity: correct the features")
    return array


def _grid_positions(rows: int, columns: int) -> np.ndarray:
    """[rows * columns, 2] row and column of every cell, row-major."""
    return np.indices((rows, columns)).reshape(2, -1).T


def _crop(value: Any) -> Crop:
    """A crop, also by its name or number."""
    if isinstance(value, str) and value.upper() in Crop.__members__:
        return Crop[value.upper()]
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and value in tuple(Crop):
        return Crop(int(value))
    raise ValueError(f"Condition.crop must be one of {[crop.name for crop in Crop]}, not {str(value)[:80]!r}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Condition:
    """What ``scjax.sample`` holds fixed; everything else is drawn.

    Attributes:
      num_lanes, num_agents: totals, with the ego and known elements; by default drawn from the prompt or the data.
      domain: a name or index from the model's list; by default drawn from the data's frequencies.
      crop: the window: centered on the ego, or ahead of it; also by its name, as "forward". None: ahead with a picture
        or the streams of one, which show nothing else, otherwise centered.
      known: one scene whose lanes and agents are kept exactly; new ones are added up to the totals. With all lanes
        known and ``num_lanes`` equal to their number this is lane-conditioned traffic generation.
      prompt: text that describes the scene; the model's text encoder turns it into the stream "text". Texts are
        stored with single spaces, in Unicode form NFC.
      negative_prompt: text that guidance leads away from, instead of from no prompt at all.
      streams: condition tokens by name (``STREAMS``), for whatever the model reads. They combine freely; ``sample``
        refuses those that the model cannot read. ``scjax.camera.raycast`` makes "image" and "depth" from a scene.
      image: a picture of the road ahead: a file, RGB [height, width, 3] of uint8, or a ``scjax.encoders.Photo``, for
        models that were trained on pictures. It becomes the streams "image" and "depth".
      depth: of the picture: [height, width] along the camera's axis, inf in the sky, NaN where it is not known; or a
        ``scjax.encoders.DepthProvider``. None: estimated, if the model has a network for it, else not known;
        ``scjax.encoders.NoDepth()``: not known.
      camera: that took the picture: a ``scjax.camera.Camera`` in the frame of the ego, its height above the ground, or
        a ``Rig`` of one. The encoder of the package reads the standard view that follows from it
        (``camera.standard_view``), by default from the preset "dashcam". For others it becomes the stream "camera".
      hold_seen: whether what the picture shows holds, for models whose encoder says where it is and if ``known`` is not
        given: agents become known elements (``generate.seen_agents``), lanes are shifted onto those that are seen, and
        no vehicle stands where none is seen (``generate.seen_picture``).
      attributes: what the scene shall show, name -> value, range or list of values, such as ``{"layout": "T",
        "vehicles": (3, 5)}``; docs/attributes.md lists them. A missing one, None and "unspecified" ask nothing.
        What a prompt asks for joins them where the model takes prompts as requests (``generate.readings``). A model
        that reads text alone gets a text made of them; ``best_of`` chooses by them; numbers of vehicles, people and
        cyclists set ``num_agents`` where it is not given.
      negative_attributes: what guidance leads away from; what a negative prompt asks for joins them in the same way.
    """

    num_lanes: int | None = None
    num_agents: int | None = None
    domain: str | int | None = None
    crop: Any = None
    known: Scene | None = None
    prompt: str | None = None
    negative_prompt: str | None = None
    streams: Mapping[str, Stream] = dataclasses.field(default_factory=dict)
    image: Any = None
    depth: Any = None
    camera: Any = None
    hold_seen: bool = True
    attributes: Any = dataclasses.field(default_factory=dict)
    negative_attributes: Any = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        for name in ("num_lanes", "num_agents"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, whole_number(value, f"Condition.{name}", 1, MAX_SLOTS))
        if self.domain is not None and not isinstance(self.domain, str):
            object.__setattr__(self, "domain", whole_number(self.domain, "Condition.domain", 0, 10_000))
        if self.crop is not None:
            object.__setattr__(self, "crop", _crop(self.crop))
        object.__setattr__(self, "hold_seen", truth_value(self.hold_seen, "Condition.hold_seen"))
        self._check_known()
        for name in ("attributes", "negative_attributes"):
            try:
                object.__setattr__(self, name, check_attributes(getattr(self, name)))
            except ValueError as error:
                raise ValueError(f"Condition.{name}: {error}") from error
        if not isinstance(self.streams, Mapping):
            raise ValueError(f"Condition.streams must map names to streams, not be a {type(self.streams).__name__}")
        for name, text in self.prompts.items():
            try:
                object.__setattr__(self, _PROMPTS[name], clean_text(text))
            except ValueError as error:
                raise ValueError(f"Condition.{_PROMPTS[name]}: {error}") from error
        self._check_image()
        self._check_streams()
        self._set_crop()

    def _check_image(self) -> None:
        """Reads the picture, and makes a provider of its depth."""
        if self.image is None:
            for name in ("depth", "camera"):
                if getattr(self, name) is not None:
                    raise ValueError(f"Condition.{name} is given without an image: give both, or leave it out")
            return
        for name in _CAMERA:
            if name in self.streams:
                raise ValueError(f"Condition.streams[{name!r}] and image are both given: leave one of them out")
        try:
            photo = as_photo(self.image)
            _ = photo.pixels
        except ValueError as error:
            raise ValueError(f"Condition.image: {error}") from error
        object.__setattr__(self, "image", photo)
        if self.camera is not None:
            try:
                object.__setattr__(self, "camera", picture_camera(self.camera, photo.size))
            except ValueError as error:
                raise ValueError(f"Condition.camera: {error}") from error
        if self.depth is not None and not isinstance(self.depth, DepthProvider):
            try:
                object.__setattr__(self, "depth", ExactDepth(self.depth))
            except ValueError as error:
                raise ValueError(f"Condition.depth: {error}") from error

    def _check_known(self) -> None:
        if self.known is None:
            return
        if not isinstance(self.known, Scene):
            raise ValueError(f"Condition.known must be a scjax.Scene, not {type(self.known).__name__}")
        try:
            validate(self.known)
        except (ValueError, AttributeError, TypeError) as error:
            raise ValueError(f"Condition.known is no valid scene: {error}") from error
        if self.known.batch_shape:
            raise ValueError(
                f"Condition.known must be a single scene, not a batch of shape {self.known.batch_shape}: take one "
                "with known[i]"
            )

    @property
    def prompts(self) -> dict[str, str]:
        """Stream name -> the prompt that fills it."""
        texts = {name: getattr(self, field) for name, field in _PROMPTS.items()}
        return {name: text for name, text in texts.items() if text is not None}

    def _check_streams(self) -> None:
        for name, stream in self.streams.items():
            if name not in STREAMS:
                raise ValueError(f"Condition.streams has no {name!r}: choose from {', '.join(STREAMS)}")
            if not isinstance(stream, Stream):
                raise ValueError(
                    f"Condition.streams[{name!r}] must be a scjax.Stream, not {type(stream).__name__}: wrap an array "
                    "[tokens, width] as scjax.Stream(array)"
                )
        for name, prompt in _PROMPTS.items():
            if name in self.streams and getattr(self, prompt) is not None:
                raise ValueError(f"Condition.streams[{name!r}] and {prompt} are both given: leave one of them out")
        if "depth" in self.streams and "image" not in self.streams:
            raise ValueError("Condition.streams: depth is given without an image: give both, or leave it out")

    def _set_crop(self) -> None:
        """The window where none is given; pictures show the road ahead alone."""
        name = (
            "image" if self.image is not None else next((f"streams[{n!r}]" for n in _CAMERA if n in self.streams), "")
        )
        if self.crop is None:
            object.__setattr__(self, "crop", Crop.FORWARD if name else Crop.CENTERED)
        elif name and self.crop != Crop.FORWARD:
            raise ValueError(
                f"Condition.{name} shows the road ahead of the ego, but the crop is {Crop(self.crop).name}: leave crop "
                "out, or give Crop.FORWARD"
            )
