"""One process at a time holds a lock, the others wait and say so once, and a killed one holds nothing."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import threading

import pytest

from kinema.locks import attempt, hold

HOLDER = """
import sys
from kinema.locks import hold
with hold(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.readline()
"""


def start_holder(path) -> subprocess.Popen:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    return holder


def test_a_second_process_waits_and_says_so_once(tmp_path):
    path, said = tmp_path / "deep" / ".lock", []
    holder = start_holder(path)

    def say():
        said.append(holder.poll())
        holder.stdin.write("go\n")
        holder.stdin.flush()

    with hold(path, waiting=say):
        assert said == [None]  # it was alive when we began to wait
        assert holder.wait(60) == 0
    with hold(path, waiting=lambda: said.append("again")):
        assert said == [None]


def test_a_killed_process_frees_its_lock(tmp_path):
    holder, said = start_holder(tmp_path / ".lock"), []

    def kill():
        said.append("waiting")
        holder.kill()

    with hold(tmp_path / ".lock", waiting=kill):
        assert said == ["waiting"]
    holder.communicate()


def test_the_lock_is_free_after_a_failure(tmp_path):
    try:
        with hold(tmp_path / ".lock"):
            raise RuntimeError
    except RuntimeError:
        pass
    with hold(tmp_path / ".lock", waiting=lambda: (_ for _ in ()).throw(AssertionError("still held"))):
        pass


def test_a_thread_does_not_hold_what_another_holds(tmp_path):
    found = []

    def work():
        with attempt(tmp_path / ".lock") as mine:
            found.append(mine)

    def other():
        thread = threading.Thread(target=work)
        thread.start()
        thread.join(60)

    with hold(tmp_path / ".lock"):
        other()
    other()
    assert found == [False, True]


@pytest.mark.parametrize("code", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP], ids=errno.errorcode.get)
@pytest.mark.parametrize("take", [hold, attempt])
def test_a_file_system_without_locks_is_told_with_the_fix(take, code, tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def flock(fd, operation):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    path = tmp_path / ".lock"
    told = re.escape(f"{os.strerror(code)}: {path} can't be locked") + ".* set KINEMA_RUNS, KINEMA_CACHE and KINEMA_STO"
    with pytest.raises(OSError, match=told) as refused, take(path):
        raise AssertionError("a file that a killed process would leave took the lock's place")
    assert refused.value.errno == code


def test_an_error_of_the_work_inside_is_left_as_it_is(tmp_path):
    with pytest.raises(OSError, match=r"^\[Errno \d+\] mine$"), hold(tmp_path / ".lock"):
        raise OSError(errno.ENOLCK, "mine")
