"""Errors of threads: they are collected, and end a training with one line."""

import asyncio
import gc
import logging
import subprocess
import sys
import threading

import pytest

from scjax.train.thread_errors import collected_thread_errors

TRAIN = """import asyncio, os, pathlib, sys, threading, time
from scjax.train import checkpoint, launch, loop

def fail(number):
    time.sleep(0.002 * number)
    sys.excepthook(ValueError, ValueError("as tensorstore reports it"), None)
    raise RuntimeError("in a thread")

def train(config, workdir):
    threads = [threading.Thread(target=fail, args=(number,)) for number in range(200)]
    for thread in threads:
        thread.start()
    if failure == "write":
        raise checkpoint.OrbaxError("no room")
    if failure == "bug":
        time.sleep(0.1)
        raise KeyError("lanes")
    for thread in threads:
        thread.join()

loop.train = train
folder, *failures = sys.argv[1:]
for failure in failures:  # a process each, which need not import anything again
    process = os.fork()
    if not process:
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(f"{folder}/{failure}.{name}", os.O_CREAT | os.O_WRONLY), number)
        sys.exit(launch.main(["--config=counts:tiny", "--workdir=x"], "scjax train"))
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    pathlib.Path(folder, failure).write_text(str(status))"""


class OwnError(Exception):
    """Errors of these tests. Late ones of other tests, such as reads of a damaged checkpoint, are not counted."""


def own(errors):
    return [repr(error) for error in errors if isinstance(error, OwnError)]


def fail_in_a_thread():
    def fail():
        raise OwnError("a")

    thread = threading.Thread(target=fail)
    thread.start()
    thread.join()


def fail_in_a_task():
    async def fail():
        raise OwnError("a")

    async def run():
        asyncio.get_running_loop().create_task(fail())
        await asyncio.sleep(0)

    asyncio.run(run())
    gc.collect()


def fail_in_a_finalizer():
    class Fails:
        def __del__(self):
            raise OwnError("a")

    Fails()
    gc.collect()


@pytest.mark.parametrize("fail", [fail_in_a_thread, fail_in_a_task, fail_in_a_finalizer])
def test_collected_thread_errors_are_not_printed(fail, capfd):
    hooks = sys.excepthook, sys.unraisablehook, threading.excepthook
    with collected_thread_errors() as errors:
        fail()
    assert own(errors) == ["OwnError('a')"]
    assert capfd.readouterr() == ("", "")
    assert (sys.excepthook, sys.unraisablehook, threading.excepthook) == hooks


@pytest.mark.parametrize("fail", [fail_in_a_thread, fail_in_a_task, fail_in_a_finalizer])
def test_collected_thread_errors_of_a_part_are_its_own(fail):
    with collected_thread_errors() as errors:
        with collected_thread_errors() as part:
            fail()
        assert own(part) == ["OwnError('a')"] and not own(errors)


def test_collected_thread_errors_leave_warnings(caplog):
    with collected_thread_errors() as errors:
        logging.getLogger("asyncio").warning("slow")
    assert "slow" in caplog.messages and not any("slow" in str(error) for error in errors)


LINES = {
    "write": "scjax train: no room\n",
    "bug": "scjax train: unexpected KeyError: 'lanes'; run with --debug for the trace, please report it\n",
    "none": (
        "scjax train: a thread in the background failed: unexpected ValueError: as tensorstore reports it; "
        "run with --debug for the trace, please report it\n"
    ),
}


@pytest.fixture(scope="module")
def failed_trainings(tmp_path_factory):
    """Folder of exit status, stdout and stderr of a training for every failure of ``LINES``."""
    folder = tmp_path_factory.mktemp("failures")
    subprocess.run([sys.executable, "-c", TRAIN, str(folder), *LINES], check=True)
    return folder


@pytest.mark.parametrize("failure", LINES)
def test_train_command_prints_one_line_while_threads_fail(failure, failed_trainings):
    texts = [(failed_trainings / name).read_text() for name in (failure, f"{failure}.out", f"{failure}.err")]
    assert texts == ["1", "", LINES[failure]]
