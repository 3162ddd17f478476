"""A manifest has one line a file: a rerun replaces what it wrote again and leaves the rest."""

from __future__ import annotations

import errno
import json
import os
import re
from dataclasses import asdict, replace

import pytest

from kinema.text.manifest import Entry, add, read_manifest
from kinema.text.prompts import Prompt, read_prompts

WALK = Entry(
    "walk.npz",
    "a person walks",
    7,
    80,
    "asked",
    20.0,
    1,
    "w",
    "humanml3d",
    "mar",
    "0123",
    "MARDM",
    {},
    False,
    1,
    "cpu",
    {},
)
BOW = replace(WALK, file="démarre.npz", text="bow", length="model", name=None, sampling={"steps": [1, 2]})


def test_a_line_is_replaced_by_that_of_the_same_file(tmp_path):
    add(tmp_path, [WALK, BOW])
    again = replace(WALK, seed=8)
    path = add(tmp_path, [again, replace(WALK, file="new.npz")])
    assert read_manifest(path) == [again, BOW, replace(WALK, file="new.npz")]
    assert "démarre" in path.read_text(encoding="utf-8")


def test_a_manifest_that_a_network_file_system_does_not_see_yet_is_kept(tmp_path, monkeypatch):
    path = add(tmp_path, [WALK])
    stat = os.stat

    def remembered(name, *args, **kwargs):
        if name == path and not made:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(name))
        return stat(name, *args, **kwargs)

    def opened(name, flags, *args, **kwargs):
        made.append(name) if name == path and flags & os.O_CREAT else None
        return open_(name, flags, *args, **kwargs)

    made, open_ = [], os.open
    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", remembered)
        patched.setattr(os, "open", opened)
        patched.setattr(os, "utime", remembered)
        add(tmp_path, [BOW])
    assert read_manifest(path) == [WALK, BOW]


def test_lines_are_prompts_that_ask_for_the_same_motions(tmp_path):
    walk, bow = read_prompts(add(tmp_path, [WALK, BOW]))
    assert walk == Prompt("a person walks", 80, seed=7, name="w", entry=WALK)
    assert bow.frames is None  # a length that was the model's own


def test_a_damaged_line_is_named(tmp_path):
    path = add(tmp_path, [WALK])
    path.write_text(path.read_text() + '{"file": "a.npz"')
    with pytest.raises(ValueError, match=r"manifest.jsonl, line 2 is damaged .* take the line out"):
        add(tmp_path, [BOW])


def test_separators_inside_of_a_text_end_no_line(tmp_path):
    walk = replace(WALK, text="a person\u2028walks\x85on\x0cand on")
    path = add(tmp_path, [walk, BOW])
    assert read_manifest(path) == [walk, BOW]
    assert [prompt.text for prompt in read_prompts(path)] == [walk.text, "bow"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": ".."}, 'line 1: name=".."'),
        ({"name": "a\x1b[2J"}, "line 1: name="),
        ({"seed": -3}, "line 1: seed=-3"),
        ({"length": "bogus"}, "line 1: length=bogus"),
        ({"frames": 0}, "line 1: frames=0"),
    ],
)
def test_a_line_of_somebody_elses_is_checked(tmp_path, changed, message):
    (tmp_path / "manifest.jsonl").write_text(json.dumps(asdict(WALK) | changed) + "\n")
    with pytest.raises(ValueError, match=re.escape(message)):
        read_prompts(tmp_path / "manifest.jsonl")
