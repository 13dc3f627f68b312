"""Text encoder folders, and prompts."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from benchmarks.robustness import damage_bytes, damage_json, names
from benchmarks.robustness.case import SOUND, Case

FOLDER = "my-encoder"
_TEXTS = ("a road with two lanes", "three cars")
_PROMPTS = (
    "a busy four-way intersection with a red light, five vehicles and two pedestrians",
    "a T-intersection with several vehicles",
    "a straight road with three lanes in each direction, ten vehicles",
    "a wrong-way driver on a motorway",
)


def folder_writer(source: Path, folder_name: str, changes: dict[str, bytes | None]) -> Callable[[Path], None]:
    """Copies a fixture as ``folder_name`` and replaces, adds or removes (None) files."""

    def write(folder: Path) -> None:
        shutil.copytree(source, folder / folder_name)
        for name, data in changes.items():
            if data is None:
                (folder / folder_name / name).unlink()
            else:
                (folder / folder_name / name).write_bytes(data)

    return write


def encoders(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Folders of text encoders: config.json, tokenizer.json, weights and their index."""
    load = names.get("load_text_encoder")

    def read(folder: Path) -> Any:
        encoder = load(folder / FOLDER)
        return encoder.width, encoder(list(_TEXTS)), encoder.is_cut("a " * 100)

    def check(result: Any) -> str | None:
        width, rows, _ = result
        for row in rows:
            if row.features.shape != (len(row.texts), width) or not len(row.features):
                return f"features have shape {row.features.shape} for {len(row.texts)} tokens"
            if not np.isfinite(row.features).all():
                return "features are not finite"
        return None

    for text, kind, changes in _encoder_damage(rng, fixtures):
        write = folder_writer(fixtures / kind, FOLDER, changes)
        yield Case(f"{kind}, {text}", read, check, (FOLDER, *changes, *damage_json.field_names(text)), write)


def _encoder_damage(rng: np.random.Generator, fixtures: Path) -> Iterator[tuple[str, str, dict[str, bytes | None]]]:
    for kind in ("bert", "umt5"):
        yield SOUND, kind, {}
        config = json.loads((fixtures / kind / "config.json").read_text())
        for text, data in damage_json.documents(rng, config, 60):
            yield f"config.json: {text}", kind, {"config.json": data}
    tokenizer = json.loads((fixtures / "bert/tokenizer.json").read_text())
    for text, data in damage_json.documents(rng, tokenizer, 50):
        yield f"tokenizer.json: {text}", "bert", {"tokenizer.json": data}
    for name in ("config.json", "tokenizer.json", "model.safetensors"):
        yield f"{name} is missing", "bert", {name: None}
    weights = (fixtures / "bert/model.safetensors").read_bytes()
    for text, data in weight_damage(rng, weights, 40):
        yield f"weights: {text}", "bert", {"model.safetensors": data}
    index = {"metadata": {"total_size": 1}, "weight_map": dict.fromkeys(damage_names(weights), "part.safetensors")}
    for text, data in damage_json.documents(rng, index, 30):
        changes = {"model.safetensors.index.json": data, "part.safetensors": weights}
        yield f"index: {text}", "bert", changes


def damage_names(data: bytes) -> list[str]:
    """Names of the arrays in a safetensors file."""
    return [name for name in damage_bytes.safetensors_parts(data)[0] if name != "__metadata__"]


def weight_damage(rng: np.random.Generator, data: bytes, number: int) -> Iterator[tuple[str, bytes]]:
    """``number`` safetensors files with damaged arrays (half), header (a quarter) and bytes (a quarter)."""
    arrays = {name: np.array(value) for name, value in sorted(safetensors.numpy.load(data).items())}
    header, body = damage_bytes.safetensors_parts(data)
    metadata = header.get("__metadata__")
    keys = list(arrays)
    for _ in range(number - 2 * (number // 4)):
        name = keys[rng.integers(len(keys))]
        rest = {key: value for key, value in arrays.items() if key != name}
        kind = int(rng.integers(4))
        if kind == 0:
            yield f"{name} is missing", safetensors.numpy.save(rest, metadata)
        elif kind == 1:
            yield f"{name} is renamed", safetensors.numpy.save({**rest, f"{name}.x": arrays[name]}, metadata)
        else:
            text, array = damage_bytes.array_damage(rng, arrays[name])
            if array.dtype.kind not in "fiub" or array.dtype == np.float16:
                text, array = "all NaN", np.full_like(arrays[name], np.nan)
            yield f"{name}: {text}", safetensors.numpy.save({**rest, name: np.ascontiguousarray(array)}, metadata)
    for text, changed in damage_json.documents(rng, header, number // 4):
        yield f"header: {text}", damage_bytes.safetensors_of(changed, body)
    yield from damage_bytes.anywhere(rng, data, number // 4)


def prompts(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Prompts through Condition, the warnings of the reader, and the shipped encoder."""
    condition, warn = (names.get(name) for name in ("Condition", "prompt_warnings"))
    encoder = names.get("load_text_encoder")(progress=False)
    warn(condition(prompt="a prompt", num_agents=3))  # the reader's encoder is no memory of a prompt

    def read(prompt: Any) -> Any:
        request = condition(prompt=prompt, num_agents=3)
        return request.prompt, warn(request), encoder([request.prompt])[0]

    def check(result: Any) -> str | None:
        prompt, warnings, tokens = result
        if not isinstance(prompt, str):
            return f"a prompt of type {type(prompt).__name__} is accepted"
        if not np.isfinite(tokens.features).all() or tokens.features.shape != (len(tokens.texts), encoder.width):
            return "features are not finite, or not of the tokens"
        return None if all(isinstance(text, str) for text in warnings) else "a warning is no text"

    for text, prompt in _prompts(rng):
        yield Case(text, lambda folder, prompt=prompt: read(prompt), check, ("prompt",), _prompt_writer(prompt))


def _prompt_writer(prompt: Any) -> Callable[[Path], None]:
    data = prompt.encode("utf-8", "surrogatepass") if isinstance(prompt, str) else repr(prompt).encode()
    return lambda folder: (folder / "prompt.txt").write_bytes(data) and None


def _prompts(rng: np.random.Generator) -> Iterator[tuple[str, Any]]:
    for prompt in _PROMPTS:
        yield SOUND, prompt
    for value in (3, 1.5, True, b"two cars", ["two cars"], {"a": 1}, ("a", "b"), object(), np.array("a road"), 0, ""):
        yield f"a prompt of type {type(value).__name__}", value
    for digits in (1, 5, 30, 300, 4299, 4300, 4301, 10_000, 100_000):
        for words in ("{} cars", "an intersection with {} pedestrians", "{}", "{} lanes in each direction"):
            yield f"{digits} digits in {words!r}", words.format("7" * digits)
    odd_digits = ("-3", "3.5", "1e9", "0", "00", "٣", "१२", "１２", "²", "½", "Ⅷ", "3,000", "0x10", "𝟛")
    for digits in odd_digits:
        yield f"{digits!a} cars", f"a road with {digits} cars"
    for size in (1_000, 32_000, 64_000, 320_000, 2_000_000):
        for part in (
            "a ",
            "a road with two cars, ",
            "no ",
            "stopped ",
            "car stopped in lane ",
            "7 ",
            ",",
            "x",
            "\n",
            "e\u0301",
        ):
            yield f"{part!r} up to {size} characters", (part * (size // len(part) + 1))[:size]
    scripts = (
        "两辆车在路口",
        "дорога с двумя машинами",
        "شارع فيه سيارتان",
        "दो कारें",
        "道路",
        "🚗🚗🚦",
        "ｆｕｌｌ ｗｉｄｔｈ",
        "\u202eroad",
    )
    for script in scripts:
        yield f"script {ascii(script)[:30]}", script
        yield f"script {ascii(script)[:30]} in English", f"a road with {script} and two cars"
    for code in (
        *range(32),
        127,
        128,
        133,
        160,
        173,
        0x200B,
        0x2028,
        0x2029,
        0xFEFF,
        0xFFFE,
        0xFFFF,
        0xD800,
        0xDFFF,
        0x10FFFF,
    ):
        yield f"character U+{code:04X}", f"a road{chr(code)}with two cars"
        yield f"character U+{code:04X} alone", chr(code)
    words = " ".join(_PROMPTS).split()
    for _ in range(80):
        chosen = list(rng.choice(words, int(rng.integers(1, 60))))
        yield "shuffled words", " ".join(chosen)
    for k in range(120):
        text = list(_PROMPTS[k % len(_PROMPTS)])
        for _ in range(int(rng.integers(1, 8))):
            text.insert(int(rng.integers(len(text))), chr(int(rng.integers(1, 0x2FFF))))
        yield "characters inserted", "".join(text)
    for k in range(60):
        data = bytearray(_PROMPTS[k % len(_PROMPTS)].encode())
        for _ in range(5):
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        yield "bits flipped, as the shell hands them over", bytes(data).decode("utf-8", "surrogateescape")
