"""Damaged records: each gives valid scenes in every crop, or a ValueError that says what to do."""

import dataclasses
import json

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from scjax.data import records
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.scene import Crop, validate
from scjax.synthetic.source import Worlds
from tests.factories.damage import damaged_bytes, damaged_json


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    build_records(Worlds(5, 3), folder, BuildOptions(split_percent=0.0))
    stored = records.open_records(folder, "train")
    return next(data for data in stored if all(value.size for value in parts(data)[0].values()))


def parts(data: bytes):
    size = int.from_bytes(data[:8], "little")
    metadata = json.loads(data[8 : 8 + size])["__metadata__"]
    return {name: np.array(value) for name, value in safetensors.numpy.load(data).items()}, metadata


def refused_or_valid(data: bytes) -> None:
    try:
        record = records.decode_record(data)
    except ValueError as error:
        message = str(error)
        assert message.startswith("data: ") and "build the records again" in message and "\n" not in message
        return
    for crop in Crop:
        validate(records.sample_scene(record, crop))
        validate(records.sample_scene(record, crop, 4.0, -3.0, 0.3, off_road=True))


@settings(max_examples=50, deadline=None)
@given(draw=st.data())
def test_decode_record_of_damaged_bytes(sound, draw):
    refused_or_valid(draw.draw(damaged_bytes(sound)))


@settings(max_examples=50, deadline=None)
@given(draw=st.data())
def test_decode_record_of_damaged_arrays(sound, draw):
    values, metadata = parts(sound)
    for name in draw.draw(st.lists(st.sampled_from(sorted(values)), min_size=1, max_size=3, unique=True)):
        value = values[name]
        kind = draw.draw(st.sampled_from(["value", "rows", "order", "dtype"]))
        if kind == "value":
            place = draw.draw(st.integers(0, value.size - 1))
            value.reshape(-1)[place] = draw.draw(arrays.from_dtype(value.dtype))
        elif kind == "rows":
            values[name] = value[: draw.draw(st.integers(0, len(value)))]
        elif kind == "order":
            values[name] = value[draw.draw(st.permutations(range(len(value))))]
        else:
            with np.errstate(all="ignore"):
                values[name] = value.astype(draw.draw(st.sampled_from(["f4", "f8", "i4", "u1"])))
    refused_or_valid(safetensors.numpy.save(values, metadata))


@settings(max_examples=30, deadline=None)
@given(draw=st.data())
def test_decode_record_of_a_damaged_origin(sound, draw):
    values, metadata = parts(sound)
    origin = draw.draw(damaged_json(json.loads(metadata["record"])))
    refused_or_valid(safetensors.numpy.save(values, {"record": json.dumps(origin)}))


def _set(name, place, value):
    def damage(values):
        values[name][place] = value

    return damage


def _mirror_neighbors(values):
    values["beside"] = np.concatenate([values["beside"], values["beside"][:, ::-1]])
    values["spans"] = np.concatenate([values["spans"], values["spans"]])


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (_set("signals", ..., 200), "signals holds values above 3"),
        (_set("agent_types", 0, 4), "agent_types holds values above 3"),
        (_set("lane_z_known", 0, 2), "lane_z_known holds values above 1"),
        (_set("agent_known", 0, 512), "agent_known holds values above 511"),
        (_set("offsets", 1, 1), "offsets do not divide"),
        (_set("offsets", 0, 1), "offsets do not divide"),
        (_set("edges", (0, 1), -1), "edges names lanes outside of"),
        (_set("beside", (0, 0), 30_000), "beside names lanes outside of"),
        (_mirror_neighbors, "on the left and on the right of each other"),
        (_set("spans", (0, 1), -5.0), "ends that come before starts"),
        (_set("spans", (0, 1), np.nan), "spans holds NaN"),
        (_set("points", (0, 0), np.nan), "points holds NaN"),
        (_set("points", (0, 2), 1e7), "points holds NaN, or lies outside"),
        (_set("points", (0, 1), 90.0), "points holds NaN, or lies outside of 80 m"),
        (_set("agents", (0, 6), 0.0), "sizes of 0 m or less"),
        (_set("agents", (0, 3), np.inf), "agents holds NaN"),
        (_set("agents", (0, 4), 0.5), "headings that are no unit vector"),
        (lambda values: values.update(spans=values["spans"][1:]), "spans has"),
        (lambda values: values.update(agents=values["agents"][1:]), "agent_types has"),
        (lambda values: values.pop("signals"), "missing required field `signals`"),
        (lambda values: values.update(points=values["points"].astype("f8")), "points.dtype"),
        (lambda values: values.update(more=values["signals"]), "unknown field `more`"),
    ],
)
def test_decode_record_names_what_is_wrong(sound, damage, fault):
    values, metadata = parts(sound)
    damage(values)
    with pytest.raises(ValueError, match=f"no scene record.*{fault}.*build the records again"):
        records.decode_record(safetensors.numpy.save(values, metadata))


@pytest.mark.parametrize(("field", "value"), [("domain", -1), ("cluster", None), ("step", "3"), ("is_recorder", 1)])
def test_decode_record_names_the_field_of_the_origin(sound, field, value):
    values, metadata = parts(sound)
    origin = {**json.loads(metadata["record"]), field: value}
    with pytest.raises(ValueError, match=f"origin: {field}: expected"):
        records.decode_record(safetensors.numpy.save(values, {"record": json.dumps(origin)}))


def test_encode_record_refuses_what_decode_record_would(sound):
    record = records.decode_record(sound)
    broken = dataclasses.replace(record.local_map, agents=np.full_like(record.local_map.agents, np.nan))
    with pytest.raises(ValueError, match="no record can be made: agents holds NaN"):
        records.encode_record(dataclasses.replace(record, local_map=broken))
