"""Files that appear whole or not at all, folders that are exchanged, locks, and bounded reading."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys

import pytest

from scjax.scene.files import (
    locked_folder,
    part_path,
    read_limited,
    remove_stale_parts,
    replace_folder,
    whole_file,
    whole_folder,
    write_file,
    write_text,
)


def _dead_process() -> int:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_whole_file_appears_at_the_end(tmp_path):
    path = tmp_path / "new" / "file.txt"
    with whole_file(path) as file:
        file.write(b"one")
        assert not path.exists()
    assert path.read_bytes() == b"one" and [p.name for p in path.parent.iterdir()] == ["file.txt"]


def test_whole_file_keeps_the_old_one_when_it_fails(tmp_path):
    path = tmp_path / "file.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError), whole_file(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_whole_file_names_the_file_of_an_error(tmp_path):
    with pytest.raises(OSError, match=r"file\.txt") as caught, whole_file(tmp_path / "file.txt"):
        raise OSError(28, "No space left on device")
    assert caught.value.errno == 28


def test_parts_of_killed_processes_are_removed(tmp_path):
    mine, other = part_path(tmp_path / "file.txt"), part_path(tmp_path / "other.txt")
    dead = tmp_path / mine.name.replace(f"-{os.getpid()}-", f"-{_dead_process()}-")
    for path in (mine, other, dead):
        path.touch()
    write_text(tmp_path / "file.txt", "whole")
    assert mine.exists() and other.exists() and not dead.exists()
    dead.mkdir()
    remove_stale_parts(tmp_path)
    assert not dead.exists() and mine.exists()


def test_writers_of_many_files_leave_the_folder_unread(tmp_path):
    dead = tmp_path / part_path(tmp_path / "file.txt").name.replace(f"-{os.getpid()}-", f"-{_dead_process()}-")
    dead.touch()
    write_file(tmp_path / "file.txt", lambda file: file.write(b"whole"), clean=False)
    assert dead.exists() and (tmp_path / "file.txt").read_text() == "whole"


def test_whole_folder_takes_its_place_at_the_end_or_not_at_all(tmp_path):
    folder = tmp_path / "a" / "folder"
    for text in ("one", "two"):
        with whole_folder(folder, "the text") as temporary:
            (temporary / "text").write_text(text)
    with pytest.raises(OSError, match=r"the text cannot be written: full") as caught:
        with whole_folder(folder, "the text") as temporary:
            (temporary / "text").write_text("three")
            raise OSError(28, "full")
    assert caught.value.filename == str(folder) and (folder / "text").read_text() == "two"
    assert [path.name for path in folder.parent.iterdir()] == ["folder"]


def test_replace_folder_exchanges_content(tmp_path):
    for name, text in (("old", "1"), ("new", "2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(text)
    replace_folder(tmp_path / "new", tmp_path / "old")
    assert (tmp_path / "old" / "file").read_text() == "2" and [p.name for p in tmp_path.iterdir()] == ["old"]


def test_locked_folder_refuses_a_second_process(tmp_path):
    code = "import sys; from pathlib import Path; from scjax.scene.files import locked_folder\n"
    code += "try:\n  with locked_folder(Path(sys.argv[1])): print('held')\nexcept ValueError as error: print(error)"
    with locked_folder(tmp_path):
        refused = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    free = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert "is in use by another process" in refused.stdout and free.stdout == "held\n"


def test_read_limited_refuses_bombs(tmp_path):
    path = tmp_path / "bomb.json.gz"
    path.write_bytes(gzip.compress(bytes(70_000_000), 1))
    with pytest.raises(ValueError, match=r"bomb\.json\.gz: expands to more than 64 MB"):
        read_limited(path)
