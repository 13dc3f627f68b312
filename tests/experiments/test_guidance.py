"""Curves over guidance scales from the JSON of prompt_adherence."""

from __future__ import annotations

import json

import pytest

from experiments.studies.guidance import draw, main, read
from experiments.studies.prompt_adherence import REALISM


def content(*scales: float) -> dict:
    values = dict.fromkeys(REALISM, 0.5)
    titles = {f"prompt, guidance {scale:g}": scale for scale in scales}
    rows = {title: {"layout": [scale, 8], "vehicles": [1, 2]} for title, scale in titles.items()}
    rows |= {"prompt, guidance 4, best of 4 repaired": {"layout": [8, 8]}, "the record itself": {"layout": [7, 8]}}
    return {"rows": rows, "realism": dict.fromkeys([*titles, "the record itself"], values)}


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "dropout 0.1.json"
    path.write_text(json.dumps(content(4, 1, 2)))
    return path


def test_read_sorts_curves_by_scale(path):
    panels, record = read(path)
    assert panels["layout [% met]"] == [(1, 12.5), (2, 25), (4, 50)]
    assert panels["vehicles [% met]"] == [(1, 50), (2, 50), (4, 50)]
    assert panels[REALISM["connection_gap_m"]] == [(scale, 0.5) for scale in (1, 2, 4)]
    assert panels[f"{REALISM['open_connections']} [%]"][0] == (1, 50)
    assert record["layout [% met]"] == 87.5


def test_draw_has_a_line_per_file_and_record(path):
    curves = read(path)
    panels = [axis for axis in draw({"a": curves, "b": curves}).axes if axis.lines]
    assert len(panels) == 2 + len(REALISM) and len(panels[0].lines) == 4


def test_study_writes_page_json_and_picture(path, tmp_path):
    main([str(path), f"--out={tmp_path / 'page'}"])
    assert (tmp_path / "page.png").stat().st_size > 1000
    assert "| dropout 0.1 | 2 | 25 | 50 |" in (tmp_path / "page.md").read_text()
    assert json.loads((tmp_path / "page.json").read_text())["dropout 0.1"]["record"]["layout [% met]"] == 87.5


@pytest.mark.parametrize(
    ("text", "message"), [("{", "not what"), ('{"rows": 1}', "not what"), (json.dumps(content(4)), "holds 1 guidance")]
)
def test_read_refuses_other_files(tmp_path, text, message):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(SystemExit, match=message):
        main([str(path), f"--out={tmp_path / 'page'}"])
