"""Reports of runs that continue, and of a full disk."""

from __future__ import annotations

import json
import resource

import pytest

from scjax.train.reporter import Reporter
from scjax.train.tensorboard import TensorBoardWriter


def steps(folder):
    return [json.loads(line)["step"] for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("cut", [b"", b'{"step": 11, "sco', b"\xff\n", b"[1]\n", b"\0\0\0"])
def test_reporter_reports_no_step_twice(tmp_path, cut):
    """Case 21: lines beyond the checkpoint are cut, also one that a kill left incomplete."""
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False) as reporter:
        for step in range(1, 11):
            reporter.scalars(step, {"loss": 1.0})
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(cut)
    with Reporter(tmp_path, first_step=8, last_step=20, tensorboard=False) as reporter:
        for step in range(9, 13):
            reporter.scalars(step, {"loss": 1.0})
    assert steps(tmp_path) == list(range(1, 13))
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_reporter_of_a_run_that_begins_anew_cuts_everything(tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False):
        pass
    assert steps(tmp_path) == []


def test_reporter_quiet_leaves_the_file(tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False, quiet=True):
        pass
    assert steps(tmp_path) == [1]


def test_reporter_writes_scalars_for_tensorboard(tmp_path):
    records = pytest.importorskip("tensorboardX.record_writer")
    with Reporter(tmp_path, first_step=4, last_step=20, tensorboard=True) as reporter:
        reporter.scalars(5, {"loss": 1.5, "rate": 3}, scope="val")
    (path,) = (tmp_path / "tensorboard").iterdir()
    events = list(read_events(path, records))
    assert [event.step for event in events if event.session_log.status] == [5]
    values = {value.tag: value.simple_value for event in events for value in event.summary.value}
    assert values == {"val/loss": 1.5, "val/rate": 3.0}


def read_events(path, records):
    """The events of a file of TensorBoard: length (8 bytes), checksum (4), event, checksum (4)."""
    from tensorboardX.proto.event_pb2 import Event

    content = path.read_bytes()
    while content:
        head, size = content[:8], int.from_bytes(content[:8], "little")
        assert int.from_bytes(content[8:12], "little") == records.masked_crc32c(head)
        yield Event.FromString(content[12 : 12 + size])
        content = content[16 + size :]


def test_tensorboard_writer_raises_on_a_full_disk(tmp_path):
    """Beyond any queue: a writer with a thread of its own would wait forever."""
    pytest.importorskip("tensorboardX")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = TensorBoardWriter(tmp_path, 0)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            for step in range(100):
                writer.scalars(step, 0.0, {"loss": 1.0})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    writer.close()
