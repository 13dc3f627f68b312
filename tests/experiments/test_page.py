"""Pages of results: they say how they were made, and their commands can be run again."""

from __future__ import annotations

import re

import pytest

from experiments import reproduce
from experiments.studies.page import write_page

PAGE = """# Title

`python -m experiments.studies.rollouts --repeats
4 --out docs/results/rollouts` makes this page with `scjax export`.

```python
scjax.load()
```

## More

    scjax data synthetic runs/records \\
        --worlds 2
"""


def test_pages_say_commit_and_machine(tmp_path):
    write_page(tmp_path / "page", PAGE, {"rows": []})
    last = (tmp_path / "page.md").read_text(encoding="utf-8").splitlines()[-1]
    assert re.fullmatch(r"Made at commit \w{7}(, with changes,)? on \d+ cores of .+\.", last)


def test_commands_are_read_from_blocks_and_lines():
    rollouts = "python -m experiments.studies.rollouts --repeats 4 --out docs/results/rollouts"
    assert reproduce.commands(PAGE) == [
        rollouts,
        "scjax export",
        "scjax data synthetic runs/records --worlds 2",
    ]
    assert reproduce.head_commands(PAGE) == [rollouts]


def test_reproduce_runs_the_commands_of_a_page_until_one_fails(tmp_path, monkeypatch):
    page = '`python -c "print(\'--one\')"`, then `python -c "exit(len(\'--t\'))"`, then `python -c "--two"`\n'
    (tmp_path / "page.md").write_text(page, encoding="utf-8")
    monkeypatch.setattr(reproduce, "RESULTS", tmp_path)
    with pytest.raises(SystemExit) as stop:
        reproduce.main(["page"])
    assert stop.value.code == 3


def test_reproduce_shows_commands_without_running_them(tmp_path, monkeypatch, capsys):
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    monkeypatch.setattr(reproduce, "RESULTS", tmp_path)
    reproduce.main(["--show", "page"])
    assert capsys.readouterr().out.startswith("python -m experiments.studies.rollouts --repeats 4")
