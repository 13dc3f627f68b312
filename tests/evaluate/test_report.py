"""One evaluation of baselines, from config to report: what its tables, pictures and files hold."""

import pytest

from scjax.evaluate.run import run_evaluation
from scjax.scene import stack
from scjax.scene.io import save_npz
from tests.factories.evaluations import SCENES, evaluation_config, read_report, save_batch
from tests.factories.traffic import agent, lane, scene

LADDER = ("other scene, same counts", "C1", "C2", "C3", "copy")


@pytest.fixture(scope="module")
def workdir(worlds, tmp_path_factory):
    """The work folder of an evaluation of all baselines and three methods from disk."""
    folder = tmp_path_factory.mktemp("report")
    copies = save_batch(folder / "copies")
    config = evaluation_config(
        worlds,
        consensus=3,
        novelty=5,
        pictures=True,
        gains=(("copy", "other scene, same counts"),),
        more=f"name=unpaired, source=npz:{copies}; name=matched, source=npz:{copies}, pairing=count-matched; "
        f"name=paired, source=npz:{copies}, pairing=in_order",
    )
    assert run_evaluation(config, folder / "out") == folder / "out" / "report.html"
    return folder / "out"


@pytest.fixture(scope="module")
def tables(workdir):
    return read_report(workdir)["tables"]


def numbers(tables, table, method):
    return {name: number["value"] for name, number in tables[table]["rows"][method]["numbers"].items()}


def test_control_is_full_for_a_copy_with_its_interval(tables):
    csc = tables["Control"]["rows"]["copy"]["numbers"]["agent CSC"]
    assert csc["value"] == pytest.approx(1) and csc["low"] == pytest.approx(1)


def test_control_climbs_the_corruption_ladder(tables):
    values = [numbers(tables, "Control", name)["lane CCS"] for name in LADDER]
    assert values == sorted(values) and values[-1] == pytest.approx(1)


def test_gain_is_the_difference_in_control(tables):
    gain = numbers(tables, "Gains in control", "copy over other scene, same counts")
    other = numbers(tables, "Control", "other scene, same counts")
    assert gain["lane CCS"] == pytest.approx(1 - other["lane CCS"])


def test_match_is_full_for_copies_and_in_order_pairs(tables):
    assert numbers(tables, "Placement of agents", "copy")["M"] == 1
    paired = numbers(tables, "Placement of agents", "paired")
    assert paired["M"] == paired["M vehicles"] == 1


def test_match_has_only_methods_that_answer_references(tables):
    rows = tables["Placement of agents"]["rows"]
    assert "unpaired" not in rows and "matched" in rows


def test_consensus_adds_average_precision(tables):
    assert "AP_consensus nuscenes" in numbers(tables, "Placement of agents", "chance")


def test_realism_of_equal_scenes_is_equal(tables):
    rows = tables["Faults of single scenes"]["rows"]
    assert rows["unpaired"]["numbers"] == rows["real"]["numbers"]


def test_distributions_of_equal_scenes_have_no_distance(tables):
    assert numbers(tables, "Lane graphs and vehicles", "unpaired")["speed_jsd"] == 0


def test_floor_has_the_metrics_of_its_table(tables):
    table = tables["Lane graphs and vehicles"]
    assert set(table["floor"]) == set(table["rows"]["unpaired"]["numbers"])


def test_attributes_and_counts_of_a_copy_agree(tables):
    assert set(numbers(tables, "Attributes", "copy").values()) == {1}
    assert numbers(tables, "Attributes", "other scene, same counts")["Relations to the ego"] < 1
    assert numbers(tables, "Numbers of lanes and agents", "copy")["agents mae"] == 0


def test_novelty_finds_copies_of_training_scenes(tables):
    assert numbers(tables, "Novelty", "unpaired")["copied"] == 1


def test_report_html_is_self_contained(workdir):
    text = (workdir / "report.html").read_text()
    assert text.count("data:image/png;base64,") == 6 and "<script" not in text and ">nan" not in text


def test_report_csv_has_a_line_per_number(workdir):
    lines = (workdir / "report.csv").read_text().splitlines()
    assert lines[0].startswith("table,row,metric,value") and len(lines) > 200


def test_report_counts_scenes_without_lanes_or_agents(tmp_path):
    scenes = [scene(), scene([agent(0, 0)]), scene([agent(0, 0), agent(9, 0)]), scene([], [lane((0, 0), (9, 0))])]
    config = evaluation_config(save_batch(tmp_path / "odd", scenes), methods=("copy", "count-matched"), novelty=2)
    run_evaluation(config, tmp_path / "out")
    tables = read_report(tmp_path / "out")["tables"]
    assert tables["Faults of single scenes"]["rows"]["copy"]["scenes"] == 4
    assert numbers(tables, "Placement of agents", "copy")["M"] == 1


def test_report_of_one_reference_and_an_empty_method(tmp_path):
    one = save_batch(tmp_path / "one", SCENES[:1])
    (tmp_path / "none").mkdir()
    save_npz(stack(SCENES[:1])[:0], tmp_path / "none" / "scenes.npz")
    config = evaluation_config(
        one, methods=("copy", {"name": "empty", "source": f"npz:{tmp_path / 'none'}"}), novelty=2
    )
    run_evaluation(config, tmp_path / "out")
    tables = read_report(tmp_path / "out")["tables"]
    assert numbers(tables, "Control", "copy")["lane SPG"] is None
    assert tables["Faults of single scenes"]["rows"]["empty"] == {"scenes": 0, "clusters": 0, "numbers": {}}
    assert tables["Lane graphs and vehicles"]["floor"] == {}
    with pytest.raises(ValueError, match="holds no scenes"):
        run_evaluation(evaluation_config(tmp_path / "none"), tmp_path / "out")
