"""Frozen encoders of conditions: text, pictures and depth into token features."""

from scjax.camera.photo import Photo, photo_from_array, read_photo
from scjax.encoders.base import TextEncoder, TokenFeatures
from scjax.encoders.depth import DepthProvider, ExactDepth, NoDepth, depth_tokens, load_depth_network
from scjax.encoders.depth_files import FileDepth
from scjax.encoders.feature_cache import FeatureCache
from scjax.encoders.preprocessing import LETTERBOX, PREPROCESSINGS, SQUASH, WIDE, Preprocessing, prepare_image
from scjax.encoders.text import FrozenTextEncoder, load_text_encoder
from scjax.encoders.vision import FrozenImageEncoder, GridTokens, ImageEncoder, load_image_encoder

__all__ = [
    "LETTERBOX",
    "PREPROCESSINGS",
    "SQUASH",
    "WIDE",
    "DepthProvider",
    "ExactDepth",
    "FeatureCache",
    "FileDepth",
    "FrozenImageEncoder",
    "FrozenTextEncoder",
    "GridTokens",
    "ImageEncoder",
    "NoDepth",
    "Photo",
    "Preprocessing",
    "TextEncoder",
    "TokenFeatures",
    "depth_tokens",
    "load_depth_network",
    "load_image_encoder",
    "load_text_encoder",
    "photo_from_array",
    "prepare_image",
    "read_photo",
]
