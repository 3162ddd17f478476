"""A run's parts are linked by relative paths, and each is loaded as what it is."""

from __future__ import annotations

import os
import shutil
import subprocess

import pytest
import torch

from kinema.atomic import new_folder, write_json
from kinema.generators.length import LengthEstimator
from kinema.runs import weights
from kinema.runs.consent import require_asked
from kinema.runs.folder import RunFolder
from kinema.runs.parts import link, load_part, read_text_encoder, upstream, write_text_encoder

SPEC = {"_target_": "kinema.generators.length.LengthEstimator", "text_dim": 4}


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "runs" / "length" / "mine"
    weights.save(LengthEstimator(text_dim=4), SPEC, RunFolder(folder).weights, part="length", step=3)
    return folder


def test_links_move_with_the_tree_of_runs(run, tmp_path):
    generator = tmp_path / "runs" / "generator" / "mine"
    assert upstream(generator) == {}
    link(generator, {"length": run})
    assert upstream(generator) == {"length": run}
    shutil.move(tmp_path / "runs", tmp_path / "elsewhere")
    moved = upstream(tmp_path / "elsewhere" / "generator" / "mine")["length"]
    assert load_part(moved)[1]["step"] == 3


def test_a_tree_of_runs_may_be_a_link_to_a_deeper_place(run, tmp_path):
    deep = tmp_path / "mnt/big/users/me/runs"
    deep.parent.mkdir(parents=True)
    shutil.move(tmp_path / "runs", deep)
    (tmp_path / "runs").symlink_to(deep, target_is_directory=True)
    generator = tmp_path / "runs" / "generator" / "mine"
    link(generator, {"length": run.resolve()})  # as a run that is given is resolved
    assert load_part(upstream(generator)["length"])[1]["step"] == 3
    link(generator, {"length": run})
    assert load_part(upstream(generator.resolve())["length"])[1]["step"] == 3


def test_a_part_is_loaded_as_what_it_is(run):
    for part in (None, "length"):
        module, meta = load_part(run, "cpu", part)
        assert isinstance(module, LengthEstimator)
        assert meta["part"] == "length"
    with pytest.raises(ValueError, match=r"length/mine holds a run of 'length'; give the folder of a 'generator' run"):
        load_part(run, "cpu", "generator")
    weights.save(torch.nn.Linear(1, 1), {"_target_": "kinema.x.Y"}, RunFolder(run).weights)
    with pytest.raises(ValueError, match=r"holds a run of None; give the folder of a 'generator' run"):
        load_part(run, "cpu", "generator")


def test_missing_and_unfinished_runs_are_named(run):
    with pytest.raises(FileNotFoundError, match=r"no run folder at .*none"):
        load_part(run / "none")
    RunFolder(run).weights.unlink()
    with pytest.raises(FileNotFoundError, match=r"has no weights\.safetensors \(its state is 'pending'\)"):
        load_part(run)
    RunFolder(run).mark("running")
    with pytest.raises(FileNotFoundError, match=r"its state is 'running'"):
        load_part(run)


def test_a_run_names_its_text_encoder(run):
    assert read_text_encoder(run) == {}
    write_text_encoder(run, "hashed", None)
    assert read_text_encoder(run) == {"encoder": "hashed", "path": None}


@pytest.mark.parametrize(
    "part",
    ["/etc", "../../../elsewhere/tokenizer", "../../../..", "../../x/../../y", "a/../../../../b", "//host/share"],
)
def test_a_part_outside_of_the_tree_of_runs_is_not_followed(tmp_path, part):
    run = tmp_path / "runs" / "generator" / "one"
    write_json(run / "upstream.json", {"tokenizer": part})
    with pytest.raises(ValueError, match=r"upstream\.json takes its tokenizer from .*, which lies outside"):
        upstream(run)


def test_a_part_outside_that_was_asked_for_is_followed_as_long_as_it_is_that_one(tmp_path, run):
    mine = tmp_path / "other" / "generator" / "one"
    link(mine, {"length": run})
    assert upstream(mine) == {"length": run}
    write_json(mine / "upstream.json", {"length": "/etc"})
    with pytest.raises(ValueError, match=r"which lies outside; if you trust that: mkdir -p .* ln -sfn /etc"):
        upstream(mine)


@pytest.mark.parametrize("part", ["a", "../../tokenizer/c", "./d/e"])
def test_parts_in_the_folder_and_in_its_tree_are_followed(tmp_path, part):
    run = tmp_path / "runs" / "generator" / "one"
    write_json(run / "upstream.json", {"tokenizer": part})
    assert upstream(run) == {"tokenizer": (run / part).resolve()}


@pytest.fixture
def evil(tmp_path):
    """Give what lies outside of an unpacked archive."""
    (tmp_path / "etc" / "x").mkdir(parents=True)
    return tmp_path / "etc" / "x"


@pytest.mark.parametrize("place", ["zz_run", "generator/zz_run", "a/b/zz_run"])
@pytest.mark.parametrize("key", ["tokenizer", "etc", "../etc", "/etc"])
def test_what_an_archive_brings_is_no_consent(tmp_path, evil, place, key):
    """Neither its links, wherever they stand and however they are called, nor a shallow place to unpack it."""
    run = tmp_path / place
    name = key.replace("/", "_")
    for folder in ("asked", "."):
        (run / folder).mkdir(parents=True, exist_ok=True)
        (run / folder / name).symlink_to(evil)
    for part in (str(evil), os.path.relpath(evil, run), name):
        write_json(run / "upstream.json", {"tokenizer": part, key: part})
        with pytest.raises(ValueError, match="which lies outside; if you trust that"):
            upstream(run)
    (run / "asked" / "text").symlink_to("someone/else")
    with pytest.raises(ValueError, match="which lies outside"):
        require_asked(run, "text", "someone/else", "it takes its text encoder from")


@pytest.mark.parametrize("place", ["zz_run", "generator/zz_run"])
def test_neighbours_are_parts_in_a_tree_of_runs_alone(tmp_path, place):
    run = tmp_path / place
    for part in ("../other", "../../home/notes", "../../generator/other"):
        write_json(run / "upstream.json", {"tokenizer": part})
        with pytest.raises(ValueError, match="which lies outside"):
            upstream(run)


def test_the_command_that_is_told_allows_it_for_this_part_of_this_run_alone(tmp_path, evil):
    run, other = tmp_path / "runs" / "generator" / "one", tmp_path / "runs" / "generator" / "other"
    for one in (run, other):
        write_json(one / "upstream.json", {"tokenizer": str(evil)})
    with pytest.raises(ValueError, match="if you trust that: ") as told:
        upstream(run)
    subprocess.run(str(told.value).partition("if you trust that: ")[2], shell=True, check=True)
    assert upstream(run) == {"tokenizer": evil}
    with pytest.raises(ValueError, match="which lies outside"):
        upstream(other)
    write_json(run / "upstream.json", {"length": str(evil)})
    with pytest.raises(ValueError, match="which lies outside"):
        upstream(run)


def test_a_run_that_is_written_beside_its_place_is_asked_for_there(tmp_path, evil):
    place = tmp_path / "imports" / "one"
    with new_folder(place) as staging:
        link(staging, {"tokenizer": evil}, place=place)
        write_text_encoder(staging, "clip_b32", "my/clip", place=place)
    assert upstream(place) == {"tokenizer": evil}
    require_asked(place, "text", "my/clip", "it takes its text encoder from")


@pytest.mark.parametrize("value", [None, 3, True, ["a"], {"a": "b"}])
def test_values_of_another_type_are_named(tmp_path, value):
    write_json(tmp_path / "upstream.json", {"tokenizer": value})
    with pytest.raises(ValueError, match=r"upstream\.json has 'tokenizer': it holds .*, allowed: a text"):
        upstream(tmp_path)
    write_json(tmp_path / "text.json", {"encoder": value, "path": None})
    with pytest.raises(ValueError, match=r"text\.json has 'encoder': it holds .*, allowed: a text"):
        read_text_encoder(tmp_path)
