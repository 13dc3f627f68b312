"""The report's flow over stand-ins for the model: right numbers where they are known, files, and users' mistakes."""

import json
import types

import numpy as np
import pytest

from experiments import report
from experiments.evaluation import Tiles, row
from scjax.scene import AgentType
from tests.metrics.worlds import agent, crossing, lane, scene

PEOPLE = [AgentType.VEHICLE, AgentType.VEHICLE, AgentType.PEDESTRIAN]


def road(shift: float):
    """A scene of its own for every ``shift``."""
    agents = [agent(0, shift), agent(10, shift, 0, 5), agent(9, shift + 6, 0, 1, (0.6, 0.6, 1.7))]
    lanes = [lane((-30, shift), (0, shift)), lane((0, shift), (30, shift))]
    return scene(agents, lanes, types=PEOPLE, joined=[(0, 1)])


@pytest.fixture
def stand_ins(monkeypatch):
    """Validation tiles that the autoencoder keeps as they are, and a sampler that repeats a tile."""
    tiles = {
        "val": Tiles([road(float(i)) for i in range(3)], ["a", "b", "c"]),
        "train": Tiles([road(3.5), road(20.0)], ["d", "e"]),
    }
    model = types.SimpleNamespace(
        denoiser={}, counts=None, domains=("womd",), notes={"steps": 7}, representation=types.SimpleNamespace(name="x")
    )
    asked = []

    def sample_many(key, conditions, *, model, steps, guidance):
        asked.extend(conditions)
        return [road(0.0) for _ in conditions]

    monkeypatch.setattr(report, "load", lambda folder: model)
    monkeypatch.setattr(report, "load_manifest", lambda folder: {"domains": ["womd"]})
    monkeypatch.setattr(report, "read_tiles", lambda folder, model, split: tiles[split])
    monkeypatch.setattr(report, "jittered_tiles", lambda folder, model, rng, count: tiles["train"])
    monkeypatch.setattr(report, "reconstruct", lambda model, scenes: scenes)
    monkeypatch.setattr(report, "sample_many", sample_many)
    return types.SimpleNamespace(model=model, tiles=tiles, asked=asked)


def run(folder, *options: str) -> dict:
    report.main(["--model=m", "--records=r", f"--out={folder}", "--samples=7", "--steps=2", *options])
    return json.loads((folder / "report.json").read_text())


def test_numbers_and_files(stand_ins, tmp_path, capsys):
    out = run(tmp_path / "out")
    sections = out["sections"]
    assert sections["reconstruction"]["validation"]["lane_point_m"]["value"] == 0
    assert sections["reconstruction"]["validation"]["link_f1"]["value"] == 1
    samples = sections["realism"]["samples at true counts"]
    assert samples["joint_gap_m"] == {"value": 0, "low": 0, "high": 0, "n": 7, "scenes": 7, "clusters": 3}
    assert samples["invalid_scenes"]["value"] == 0
    novelty = sections["novelty"]
    assert novelty["samples"]["lane_distance_m"]["value"] == 3.5 and novelty["samples"]["M"]["value"] == 0
    assert novelty["real validation"]["lane_distance_m"]["value"] == pytest.approx(2.5)
    assert novelty["real validation"]["lane_distance_p50_m"]["low"] is None
    assert novelty["samples"]["aligned_lane_distance_m"]["value"] == pytest.approx(0, abs=1e-3)
    assert novelty["copies"]["lane_distance_m"]["value"] == 0 and novelty["copies"]["M"]["value"] == 1
    assert set(novelty) == {"samples", "real validation", "copies"}
    assert novelty["copies"]["copied"]["value"] == 1 and novelty["samples"]["copied"]["value"] == 0
    assert novelty["samples"]["aligned_copied"]["value"] == 1  # 3.5 m aside
    placed = sections["lane_conditioned"]
    assert placed["real"]["M"]["value"] == placed["real"]["vehicle_PxR"]["value"] == 1
    assert placed["random placement"]["M"]["scenes"] == 30 and placed["random placement"]["M"]["clusters"] == 3
    assert placed["random placement"]["vehicles_on_lane"]["value"] == 1
    # Three tiles 0, 1 and 2 m off what the sampler repeats: matches below 1, 2, 3 m are 1, 2, 3 of 3.
    assert placed["independent sample"]["M"]["value"] == pytest.approx(2 / 3)
    assert out["about"]["model"] == {"steps": 7} and out["about"]["tiles"]["training"] == {"scenes": 2, "clusters": 2}
    names = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert names == {"report.json", "report.md", "samples.npz", "reconstruction.png", "samples.png",
                     "lane_conditioned.png"}  # fmt: skip
    text = capsys.readouterr().out
    assert (
        "| joint_gap_m | 0 [0, 0] (n=7) |" in text and text.strip() == (tmp_path / "out/report.md").read_text().strip()
    )


def test_requests(stand_ins, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "picture", lambda *_: None)
    run(tmp_path, "--lane-tiles=2")
    free, given = stand_ins.asked[:7], stand_ins.asked[7:]
    assert len(given) == 2
    assert all((c.num_lanes, c.num_agents, c.domain, c.known) == (2, 3, "womd", None) for c in free)
    for condition in given:
        assert len(condition.known.agent_mask) == 0 and condition.known.lane_mask.sum() == 2
        assert (condition.num_lanes, condition.num_agents) == (2, 3)


def test_an_autoencoder_alone_is_reported_too(stand_ins, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "picture", lambda *_: None)
    stand_ins.model.denoiser = None
    assert set(run(tmp_path)["sections"]) == {"reconstruction", "realism"}
    assert not stand_ins.asked


def test_results_keep_the_order_of_what_was_asked():
    items = [road(float(i)) if i % 2 else crossing() for i in range(150)]
    made = report.by_parts(items, lambda part, number: part, "test")
    assert all(one is other for one, other in zip(items, made, strict=True))


def test_rows_pool_over_scenes_and_count_clusters():
    numbers = row([{"m": (1.0, 4.0)}, {"m": (3.0, 4.0)}, {"m": (2.0, 8.0)}], ["a", "a", "b"])
    assert numbers["m"].value == 6 / 16 and (numbers["m"].n, numbers["m"].scenes, numbers["m"].clusters) == (16, 3, 2)
    assert numbers["m"].low == 0.25 and numbers["m"].high == 0.5  # each cluster alone


def test_a_diverged_model_is_named(stand_ins, tmp_path, monkeypatch):
    bad = road(0.0)
    bad.agents[1, 0] = np.nan
    monkeypatch.setattr(report, "sample_many", lambda key, conditions, **_: [bad for _ in conditions])
    monkeypatch.setattr(report, "picture", lambda *_: None)
    with pytest.raises(SystemExit, match="7 of 7 samples are no valid scenes"):
        run(tmp_path)
    saved = json.loads((tmp_path / "report.json").read_text())
    assert saved["sections"]["realism"]["samples at true counts"]["invalid_scenes"]["value"] == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [(["--samples=0"], "--samples must be at least 1"), (["--drawn=-1"], "--drawn"), (["--steps=x"], "invalid int")],
)
def test_wrong_arguments_end_with_a_line(tmp_path, capsys, options, message):
    with pytest.raises(SystemExit):
        report.main(["--model=m", "--records=r", f"--out={tmp_path}", *options])
    assert message in capsys.readouterr().err


def test_missing_folders_end_with_a_line(tmp_path):
    with pytest.raises(SystemExit, match=r"experiments\.report: .*is no model folder"):
        report.main([f"--model={tmp_path}/none", "--records=r", f"--out={tmp_path}/out"])
