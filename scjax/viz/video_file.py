"""Frames in files that browsers play: GIF and MP4 (H.264)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

from scjax.scene.files import write_file

SUFFIXES = (".gif", ".mp4")
_MAX_COLORS = 256  # of a GIF
_MIXTURES = (
    (1.0, 0.0),
    (0.75, 255.0),
    (0.5, 255.0),
    (0.28, 235.0),
    (0.5, 40.0),
)
"""Share of a color, and the gray that it is mixed with."""

_BT709, _LIMITED = 1, 1  # numbers of the color space and the range of values that players expect
_ENCODER: dict[str, object] = {
    "preset": "superfast",
    "crf": "26",  # constant rate factor; lower is better and larger
    "threads": "1",
    "x264-params": "scenecut=0:rc-lookahead=0:mbtree=0:weightp=0:bframes=3:b-adapt=0",
}
"""Of H.264: nothing looks ahead and three of four frames lie between others, in half of the time of the preset
veryfast. Drawings become as large as with that one (``benchmarks/README.md``, wireframes)."""


def video_suffix(path: str | Path) -> str:
    """The ending of ``path`` in small letters, if frames can be written to such a file.

    Raises:
      ValueError: it is another ending, or the encoder of MP4 is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path}: animations are GIF or MP4 files: give a name that ends in .gif or .mp4")
    if suffix == ".mp4" and not _has_encoder():
        raise ValueError(
            f"{path}: MP4 files need PyAV, which is not installed: pip install 'scjax[video]', or write a .gif"
        )
    return suffix


def write_video(
    frames: Iterable[np.ndarray], path: str | Path, frames_per_second: float, colors: Sequence[str] = ()
) -> None:
    """Writes a GIF or an MP4, by the ending of ``path``. The file appears whole or not at all.

    Args:
      frames: RGB pictures of one size [height, width, 3] uint8; at least one. An MP4 needs even sizes.
      frames_per_second: how fast they are shown. A GIF counts hundredths of a second.
      colors: that a GIF must show well, also if the first frame has little of them; others are those of that frame.

    Raises:
      ValueError: as ``video_suffix``; there are no frames; or a size is odd.
    """
    path = Path(path)
    if video_suffix(path) == ".gif":
        _write_gif(frames, path, frames_per_second, colors)
    else:
        _write_mp4(frames, path, frames_per_second)


def _write_gif(frames: Iterable[np.ndarray], path: Path, frames_per_second: float, colors: Sequence[str]) -> None:
    """All frames share one palette, so that colors do not change from frame to frame."""
    images: list[Image.Image] = []
    palette = None
    for frame in frames:
        image = Image.fromarray(frame)
        palette = _palette(image, colors) if palette is None else palette
        images.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    if not images:
        raise ValueError(f"{path}: there are no frames to write: give at least one")
    # Whole hundredths of a second whose sum is right, though each of them is rounded.
    ends = np.round(100 * np.arange(len(images) + 1) / frames_per_second).astype(int)
    durations = (10 * np.maximum(np.diff(ends), 2)).tolist()
    write_file(
        path,
        lambda file: images[0].save(
            file, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0, disposal=1
        ),
    )


def _palette(first: Image.Image, colors: Sequence[str]) -> Image.Image:
    """An image with a palette of ``colors``, their mixtures with light and dark, and colors of the first frame."""
    chosen = np.array([ImageColor.getrgb(color) for color in colors], float).reshape(-1, 3)
    mixtures = [share * chosen + (1 - share) * other for share, other in _MIXTURES]
    others = _MAX_COLORS - len(_MIXTURES) * len(chosen)
    if others < 16:
        raise ValueError(f"{len(chosen)} colors are more than a palette of {_MAX_COLORS} holds with their mixtures")
    common = first.quantize(others, Image.Quantize.MEDIANCUT).getpalette() or []
    image = Image.new("P", (1, 1))
    image.putpalette(np.concatenate(mixtures).round().astype(int).ravel().tolist() + common)
    return image


def _write_mp4(frames: Iterable[np.ndarray], path: Path, frames_per_second: float) -> None:
    """H.264 with 4:2:0 chroma and the index at the front: what browsers and phones play while it loads."""
    import av

    rate = Fraction(frames_per_second).limit_denominator(1000)
    with tempfile.TemporaryDirectory() as folder:  # the encoder opens its file twice to move the index to the front
        draft = Path(folder) / "video.mp4"
        with av.open(str(draft), "w", format="mp4", options={"movflags": "+faststart"}) as container:
            stream = None
            for frame in frames:
                if stream is None:
                    height, width = frame.shape[:2]
                    if height % 2 or width % 2:
                        raise ValueError(f"{path}: frames of {width} x {height} pixels: an MP4 needs even numbers")
                    stream = container.add_stream("libx264", rate=rate)
                    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                    context = stream.codec_context
                    context.colorspace = context.color_primaries = context.color_trc = _BT709
                    context.color_range = _LIMITED
                    stream.options = _ENCODER
                picture = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(frame), format="rgb24")
                picture = picture.reformat(format="yuv420p", dst_colorspace=_BT709, dst_color_range=_LIMITED)
                container.mux(stream.encode(picture))
            if stream is None:
                raise ValueError(f"{path}: there are no frames to write: give at least one")
            container.mux(stream.encode())
        content = draft.read_bytes()
    write_file(path, lambda file: file.write(content))


def _has_encoder() -> bool:
    try:
        import av  # noqa: F401
    except ImportError:
        return False
    return True
