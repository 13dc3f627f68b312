"""Curves over guidance weights from the numbers of experiments.studies.prompt_adherence."""

from __future__ import annotations

import json

import pytest

from experiments.studies.guidance import draw, main, read
from experiments.studies.prompt_adherence import SOUND


def content(*weights: float) -> dict:
    sound = {name: 0.5 for name in SOUND}
    titles = {f"prompt, guidance {weight:g}": weight for weight in weights}
    rows = {title: {"layout": [weight, 8], "vehicles": [1, 2]} for title, weight in titles.items()}
    rows |= {"prompt, guidance 4, best of 4": {"layout": [8, 8]}, "the record itself": {"layout": [7, 8]}}
    return {"rows": rows, "realism": dict.fromkeys([*titles, "the record itself"], sound)}


def test_curves_are_the_rows_in_order_of_their_weights(tmp_path):
    path = tmp_path / "dropout 0.1.json"
    path.write_text(json.dumps(content(4, 1, 2)))
    curves, record = read(path)
    assert curves["layout [% met]"] == [(1, 12.5), (2, 25), (4, 50)]
    assert curves["vehicles [% met]"] == [(1, 50), (2, 50), (4, 50)]
    assert curves[SOUND["connection_gap_m"]] == [(w, 0.5) for w in (1, 2, 4)]
    assert curves[f"{SOUND['open_joints']} [%]"][0] == (1, 50)
    assert record["layout [% met]"] == 87.5
    figure = draw({"a": (curves, record), "b": (curves, record)}, tmp_path / "b.png")
    shown = [axis for axis in figure.axes if axis.lines]
    assert len(shown) == 2 + len(SOUND) and len(shown[0].lines) == 4  # two curves and two records
    main([str(path), "--out", str(tmp_path / "a.png")])
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("text", "said"), [("{", "not what"), ('{"rows": 1}', "not what"), (json.dumps(content(4)), "holds 1 guidance")]
)
def test_other_files_are_refused(tmp_path, text, said):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(SystemExit, match=said):
        main([str(path), "--out", str(tmp_path / "a.png")])
