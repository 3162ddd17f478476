"""Files and folders are written whole or not at all, whatever fails or is killed in between."""

from __future__ import annotations

import errno
import json
import os
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from kinema.atomic import ABANDONED, _machine, new_folder, replacing, staging_folder, write_json, write_text


def test_a_file_takes_its_place_at_the_end(tmp_path):
    path = write_text(tmp_path / "deep" / "a.txt", "old\n")
    with replacing(path, sync=True) as temporary:
        temporary.write_text("new\n")
        assert temporary.suffix == ".txt"
        assert path.read_bytes() == b"old\n"
    assert path.read_bytes() == b"new\n"
    assert [f.name for f in path.parent.iterdir()] == ["a.txt"]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such permissions")
def test_files_and_folders_are_for_others_to_read_as_the_umask_says(tmp_path):
    before = os.umask(0o022)
    try:
        write_text(tmp_path / "a.txt", "")
        with replacing(tmp_path / "c.bin") as temporary:  # as safetensors does
            temporary.touch(mode=0o600)
        with new_folder(tmp_path / "b"):
            pass
    finally:
        os.umask(before)
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in "b"] == [0o755]
    assert [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("a.txt", "c.bin")] == [0o644] * 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.txt", "b", "c.bin"]


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "old").touch()
    with pytest.raises(RuntimeError, match="on the way"):
        fail_within(new_folder(tmp_path / "a", replace=True), half_folder)
    assert [f.name for f in (tmp_path / "a").iterdir()] == ["old"]
    with new_folder(tmp_path / "a", replace=True) as staging:
        (staging / "new").touch()
    assert [f.name for f in (tmp_path / "a").iterdir()] == ["new"]
    assert [f.name for f in tmp_path.iterdir()] == ["a"]


def fail_within(context, write):
    with context as temporary:
        write(temporary)
        raise RuntimeError("on the way")


def half_file(path):
    path.write_text("half")


def half_folder(path):
    (path / "half").touch()


@pytest.mark.parametrize("sole", [False, True])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, sole):
    path = write_text(tmp_path / "a.txt", "old\n")
    with pytest.raises(RuntimeError, match="on the way"):
        fail_within(replacing(path, sole=sole), half_file)
    assert path.read_text() == "old\n"
    assert [f.name for f in tmp_path.iterdir()] == ["a.txt"]


def test_a_sole_writer_takes_away_what_a_killed_one_left(tmp_path):
    killed = replacing(tmp_path / "a.bin", sole=True), new_folder(tmp_path / "run", sole=True)
    for context, leave in zip(killed, (half_file, half_folder), strict=True):
        leave(context.__enter__())  # and never comes back
    assert len(list(tmp_path.iterdir())) == 2
    with replacing(tmp_path / "a.bin", sole=True) as temporary:
        temporary.write_text("x")
    with new_folder(tmp_path / "run", sole=True) as staging:
        (staging / "whole").touch()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.bin", "run", "whole"]
    assert (tmp_path / "a.bin").read_text() == "x"


def test_json_that_cannot_be_written_leaves_the_old_file(tmp_path):
    write_json(tmp_path / "a.json", {"b": 2, "a": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"a": object()})
    assert list(json.loads((tmp_path / "a.json").read_text())) == ["a", "b"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_is_new_and_whole_or_not_there(tmp_path):
    with new_folder(tmp_path / "deep" / "run") as staging:
        (staging / "a").touch()
        assert not (tmp_path / "deep" / "run").exists()
    assert [p.name for p in (tmp_path / "deep").rglob("*")] == ["run", "a"]
    with pytest.raises(ValueError, match="run exists; choose another folder"), new_folder(tmp_path / "deep" / "run"):
        pass
    with pytest.raises(RuntimeError, match="on the way"):
        fail_within(new_folder(tmp_path / "other"), half_folder)
    with staging_folder(tmp_path / "other") as staging:
        half_folder(staging)
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]


def test_writers_of_one_file_do_not_disturb_each_other(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda i: write_json(tmp_path / "a.json", {"a": [i] * 1000}), range(64)))
    assert len(set(json.loads((tmp_path / "a.json").read_text())["a"])) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


KILLED = """
import os, signal, sys
from kinema.atomic import new_folder, replacing
places = [replacing(sys.argv[1] + "/a.bin"), new_folder(sys.argv[1] + "/run")]
for place in places:
    temporary = place.__enter__()
    (temporary / "half" if temporary.is_dir() else temporary).write_text("half")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are seen in /proc")
def test_what_a_killed_process_left_is_removed_by_the_next_that_writes_there(tmp_path):
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)]).returncode == -9
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / ".a-other.bin").touch()
    write_text(tmp_path / "a.bin", "x")
    with new_folder(tmp_path / "run"):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == [".a-other.bin", "a.bin", "run"]


@pytest.mark.parametrize("who", ["0badcafe-77-", ""], ids=["another machine's", "of before"])
def test_what_may_be_written_still_stays(tmp_path, who):
    own, old, new = (
        tmp_path / f".a-{name}.txt"
        for name in (f"{_machine()}-{os.getpid()}-{8 * 'a'}", f"{who}{8 * 'b'}", f"{who}{8 * 'c'}")
    )
    for path in (own, old, new):
        path.touch()
    past = time.time() - ABANDONED - 60
    for path in (own, old):
        os.utime(path, (past, past))
    write_text(tmp_path / "a.txt", "x")
    assert sorted(tmp_path.iterdir()) == sorted([own, new, tmp_path / "a.txt"])


def test_a_folder_is_listed_once_however_many_files_are_written(tmp_path, monkeypatch):
    listed, listdir = [], os.listdir
    monkeypatch.setattr(os, "listdir", lambda folder: listed.append(str(folder)) or listdir(folder))
    for number in range(20):
        write_text(tmp_path / f"{number}.txt", "x")
    assert listed == [str(tmp_path)]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("place", [replacing, new_folder, staging_folder])
def test_a_full_disk_names_the_file_and_the_fix(tmp_path, code, place):
    def full(_):
        raise OSError(code, os.strerror(code))

    def told(_):
        raise OSError(code, "it needs 4 GB")

    with pytest.raises(OSError, match=r"is not written; free disk space") as caught:
        fail_within(place(tmp_path / "a.bin"), full)
    assert caught.value.errno == code
    with pytest.raises(OSError, match="it needs 4 GB"):
        fail_within(place(tmp_path / "a.bin"), told)
    assert not list(tmp_path.iterdir())


def test_a_file_is_on_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    path, before = write_text(tmp_path / "a.txt", "old"), []
    monkeypatch.setattr(os, "fsync", lambda _: before.append(path.read_text()))
    with replacing(path, sync=True) as temporary:
        temporary.write_text("new")
    assert before == ["old"]
