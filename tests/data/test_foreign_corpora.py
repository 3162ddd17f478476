"""Corpora as people have them: stray files, links, other rates and conventions, one bad clip among good ones."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from kinema import cli
from kinema.data.catalog import read_joints_folder
from kinema.data.doctor import diagnose, exit_code, format
from kinema.data.prepare import list_files, prepare, prepare_store, read_corpus
from kinema.data.store import PackedStore
from kinema.data.synthetic import synthetic_clips, write_joints_folder
from kinema.experiments.config import compose
from kinema.experiments.corpus import files_listed_once, open_corpus
from kinema.experiments.groups import check_groups
from kinema.motion.convention import Convention
from kinema.motion.features import extract
from kinema.motion.resampling import resampled
from kinema.motion.skeleton import HUMANML3D


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """Give a joints folder of 30 clips."""
    return write_joints_folder(synthetic_clips(size=30, seed=2), tmp_path_factory.mktemp("sound") / "corpus")


@pytest.fixture
def folder(sound, tmp_path) -> Path:
    """Give a copy that may be spoilt."""
    return Path(shutil.copytree(sound, tmp_path / "corpus"))


def files(folder: Path) -> list[Path]:
    return sorted((folder / "joints").glob("*.npy"))


def write(file: Path, array: np.ndarray) -> None:
    np.save(file, array, allow_pickle=array.dtype == object)


def change_all(folder: Path, change) -> None:
    for file in files(folder):
        np.save(file, change(np.load(file)))


ONE_BAD = {
    "squeezed": lambda file, j: write(file, j[0]),
    "one frame": lambda file, j: write(file, j[:1]),
    "no frame": lambda file, j: write(file, j[:0]),
    "flat": lambda file, j: write(file, j.reshape(len(j), -1)),
    "transposed": lambda file, j: write(file, j.transpose(1, 2, 0)),
    "batch": lambda file, j: write(file, j[None]),
    "features": lambda file, j: write(file, extract(j, HUMANML3D)),
    "17 joints": lambda file, j: write(file, j[:, :17]),
    "nan": lambda file, j: write(file, np.where(np.arange(22)[:, None] == 3, np.nan, j)),
    "infinite": lambda file, j: write(file, np.where(np.arange(22)[:, None] == 3, np.inf, j)),
    "collapsed": lambda file, j: write(file, np.zeros_like(j)),
    "centimetres": lambda file, j: write(file, j * 100),
    "z up": lambda file, j: write(file, j[..., [0, 2, 1]] * np.float32([1, -1, 1])),
    "mirrored": lambda file, j: write(file, j * np.float32([-1, 1, 1])),
    "shuffled": lambda file, j: write(file, j[:, ::-1]),
    "objects": lambda file, j: write(file, np.array([{"motion": j}], dtype=object)),
    "complex": lambda file, j: write(file, j.astype(complex)),
    "texts": lambda file, j: write(file, np.array(["walk"])),
    "empty": lambda file, j: file.write_bytes(b""),
    "cut": lambda file, j: file.write_bytes(file.read_bytes()[:3000]),
    "pointer": lambda file, j: file.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n"),
    "page": lambda file, j: file.write_bytes(b"<html>quota exceeded</html>"),
    "archive": lambda file, j: np.savez(file.open("wb"), joints=j),
}


@pytest.mark.parametrize("kind", ONE_BAD)
def test_one_bad_clip_is_left_out_and_said(folder, tmp_path, capsys, kind):
    bad = files(folder)[3]
    ONE_BAD[kind](bad, np.load(bad))
    store = PackedStore.open(prepare(read_joints_folder(folder), tmp_path / "store", name="x", mirror=False))
    assert store.num_clips == 29
    (dropped,) = [d for d in store.dropped if d["what"] == "clip"]
    assert dropped["name"] == bad.stem
    said = capsys.readouterr().out
    assert f"left out  1 unusable clips: {bad.stem} (" in said
    assert f"{store.num_entries} entries are left" in said
    findings = diagnose(folder)
    assert exit_code(findings) == 0
    assert exit_code(findings, strict=True) == 1
    assert bad.stem in format(findings)


@pytest.mark.parametrize("kind", ["squeezed", "empty", "features", "centimetres", "z up", "mirrored", "shuffled"])
def test_many_bad_clips_stop_with_the_reason_and_the_fix(folder, tmp_path, kind):
    for file in files(folder)[:10]:
        ONE_BAD[kind](file, np.load(file))
    with pytest.raises(
        ValueError, match=r"10 of 30 clips are unusable, more than .* 0\.2: 10 clips .*--set max_unusable="
    ):
        prepare(read_joints_folder(folder), tmp_path / "store", name="x")
    assert not (tmp_path / "store").exists()
    kept = prepare(read_joints_folder(folder), tmp_path / "store", name="x", mirror=False, max_unusable=0.5)
    assert PackedStore.open(kept).num_clips == 20


@pytest.mark.parametrize(
    ("change", "told", "kind", "fix"),
    [
        (lambda j: j[..., [0, 2, 1]] * np.float32([1, -1, 1]), {"up": "z"}, "axis", "--up z"),
        (lambda j: j * np.float32([1, -1, -1]), {"up": "-y"}, "axis", "--up -y"),
        (lambda j: j * 100, {"scale": 0.01}, "unit", "--scale 0.01"),
        (lambda j: j * np.float32([-1, 1, 1]), {"handed": "left"}, "sides", "--handed left"),
    ],
)
def test_a_foreign_folder_is_one_finding_and_prepared_with_its_fix(folder, sound, tmp_path, change, told, kind, fix):
    change_all(folder, change)
    findings = diagnose(folder)
    (found,) = [f for f in findings if f.kind == kind]
    assert found.severity == "error"
    assert fix in found.fix
    assert {f.kind for f in findings if f.severity == "error"} == {kind, "empty split"}
    assert exit_code(diagnose(folder, convention=Convention(**told))) == 0
    stores = [
        PackedStore.open(prepare_store("joints", source, tmp_path / "stores", name=source.parent.name, **options))
        for source, options in ((folder, told), (sound, {}))
    ]
    np.testing.assert_allclose(stores[0].features[:], stores[1].features[:], atol=2e-4)


def test_a_store_shows_what_its_joints_were(folder, tmp_path):
    change_all(folder, lambda j: j * np.float32([-1, 1, 1]))
    store = prepare(read_joints_folder(folder, handed="right"), tmp_path / "store", name="x", mirror=False)
    (found,) = [f for f in diagnose(store) if f.kind == "sides"]
    assert found.severity == "error"
    with pytest.raises(ValueError, match="prepare it again with these options"):
        diagnose(store, convention=Convention(handed="left"))


def test_stray_files_and_links_are_no_clips(folder, tmp_path, capsys):
    for file in files(folder)[:3]:
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X        ")
    (folder / "joints" / ".DS_Store").write_bytes(b"\0")
    (folder / "joints" / "__MACOSX").mkdir()
    shutil.move(folder / "joints", tmp_path / "elsewhere")
    (folder / "joints").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "again").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "after").symlink_to(tmp_path / "elsewhere" / "__MACOSX")  # which hides no clips of it
    findings = diagnose(folder)
    assert exit_code(findings, strict=True) == 0, format(findings)
    assert "unlisted files" not in {f.kind for f in findings}
    assert len(read_joints_folder(folder)) == 30
    first = prepare_store("joints", folder, tmp_path / "stores", name="x")
    np.save(tmp_path / "elsewhere" / "new.npy", np.zeros(3))
    assert prepare_store("joints", folder, tmp_path / "stores", name="x") != first


def test_clips_may_lie_behind_a_linked_folder(folder, tmp_path):
    name = files(folder)[0].stem
    shutil.move(folder / "joints" / f"{name}.npy", tmp_path)
    (folder / "joints" / "more").symlink_to(tmp_path / "taken")
    (tmp_path / "taken").mkdir()
    shutil.move(tmp_path / f"{name}.npy", tmp_path / "taken")
    shutil.copytree(folder / "texts", folder / "texts" / "more")
    for split in ("train", "val", "test"):
        file = folder / f"{split}.txt"
        file.write_text(file.read_text().replace(name, f"more/{name}"))
    catalog = read_joints_folder(folder)
    assert (len(catalog), len(catalog.dropped)) == (30, 0)
    (folder / "joints" / "also").symlink_to(tmp_path / "taken")  # a second way to them
    catalog = read_joints_folder(folder)
    assert (len(catalog), len(catalog.dropped)) == (30, 0)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("3", "manifest.json .* a list"),
        ("null", "manifest.json .* a list"),
        ("[1]", "manifest.json has a clip, number 1, that holds a number"),
        ('[{"name": "a"}, {"nam": "x"}]', "manifest.json has a clip, number 2, that has 'name'"),
        ('[{"name": ["a"]}]', "manifest.json has a clip, number 1, that has 'name': it holds a list"),
        ("[" * 20000, "manifest.json is nested"),
        ("[", "manifest.json is damaged"),
        (b"\xff\xfe\xff", "manifest.json"),
    ],
)
def test_a_list_of_clips_that_is_none_is_named(folder, content, told):
    (folder / "manifest.json").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=told):
        read_joints_folder(folder)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"a,b\n1,2\n", "index.csv has no column source_path, new_name"),
        (b"source_path,new_name\n\xff,x\n", r"index.csv is not UTF-8 \(line 2"),
        (b"source_path,start_frame,end_frame,new_name\nx,one,2,a.npy\n", "index.csv: a.npy has start_frame 'one'"),
    ],
)
def test_an_index_that_is_none_is_named(folder, content, told):
    (folder / "index.csv").write_bytes(content)
    with pytest.raises(ValueError, match=told):
        read_joints_folder(folder)


@pytest.mark.parametrize("share", ["x", "nan", "2", "-1"])
def test_a_share_of_clips_that_is_none_is_told_before_any_is_read(folder, share, capsys):
    words = ["prepare", str(folder), "--format", "joints", "--out", "store", "--set", f"max_unusable={share}"]
    assert cli.main(words) == 2
    assert "max_unusable=" in capsys.readouterr().err


def test_the_share_that_may_be_lost_is_an_option_of_the_configuration(folder, tmp_path):
    def asked(*more: str) -> Path:
        return open_corpus(compose(["data=custom", f"data.source={folder}", f"paths.stores={tmp_path}/stores", *more]))

    assert asked("+data.options.max_unusable=0.5") != asked("+data.options.max_unusable=0.1")
    with pytest.raises(ValueError, match=r"data\.options\.max_unusable=2: must be"):
        check_groups(compose(["data=custom", f"data.source={folder}", "+data.options.max_unusable=2"]))


@pytest.mark.parametrize(
    "spell",
    [lambda n: f"{n}.npy\n", lambda n: f"{n}.npy\r\n", lambda n: f"  {n}  \n\n", lambda n: f"{n}\r\n"],
)
def test_lists_name_clips_with_or_without_suffix(folder, spell):
    for split in ("train", "val", "test"):
        names = (folder / f"{split}.txt").read_text().split()
        (folder / f"{split}.txt").write_bytes("".join(map(spell, names)).encode("utf-8-sig"))
    assert len(read_joints_folder(folder)) == 30
    assert exit_code(diagnose(folder), strict=True) == 0


@pytest.mark.parametrize("fps", [30, 60, 100, 120])
def test_clips_of_another_rate_are_resampled(folder, sound, tmp_path, capsys, fps):
    change_all(folder, lambda j: resampled(j, 20.0, fps))
    store = PackedStore.open(prepare_store("joints", folder, tmp_path / "a", name="x", fps=fps, mirror=False))
    assert f"rate      {fps} fps, asked for; entries have 20 fps" in capsys.readouterr().out
    plain = PackedStore.open(prepare_store("joints", sound, tmp_path / "a", name="y", mirror=False))
    lengths = [s.clips["frames"].astype(int) for s in (store, plain)]
    assert np.abs(lengths[0] - lengths[1]).max() <= 1
    assert store.num_entries == plain.num_entries
    assert exit_code(diagnose(folder, convention=Convention(fps=fps)), strict=True) == 0


def test_a_manifest_tells_the_rate_of_each_clip(folder, tmp_path, capsys):
    fast = files(folder)[:5]
    for file in fast:
        np.save(file, np.repeat(np.load(file), 3, axis=0))
    names = {f.stem: 60 for f in fast}
    (folder / "manifest.json").write_text(
        json.dumps([{"name": f.stem, "fps": names.get(f.stem, 20)} for f in files(folder)])
    )
    catalog = read_joints_folder(folder)
    assert {c.name: c.convention.fps for c in catalog if c.name in names} == dict.fromkeys(names, 60.0)
    assert catalog.rate == "20, 60 fps, as manifest.json says"
    store = PackedStore.open(prepare(catalog, tmp_path / "store", name="x", mirror=False))
    assert store.manifest["dropped"]["clip"] == 0
    assert store.clips["frames"].max() < 200
    (folder / "manifest.json").write_text(json.dumps([{"name": fast[0].stem, "fps": "fast"}]))
    with pytest.raises(ValueError, match=r"manifest\.json: clip .* has fps 'fast'"):
        read_joints_folder(folder)


def test_a_rate_that_nobody_told_is_guessed(folder):
    change_all(folder, lambda j: resampled(j, 20.0, 120.0)[:190])
    (found,) = [f for f in diagnose(folder) if f.kind == "rate" and f.severity == "warning"]
    assert "--fps" in found.fix
    assert "guessed" in found.message


@pytest.mark.parametrize("frames", [20, 300])
def test_a_corpus_without_entries_is_an_error_as_folder_and_as_store(folder, tmp_path, capsys, frames):
    shutil.rmtree(folder / "texts")  # some of its captions are about parts
    change_all(folder, lambda j: np.concatenate([j] * 9)[:frames])
    store = prepare(read_joints_folder(folder), tmp_path / "store", name="x", mirror=False)
    assert "warning   no entry is left in train, val, test" in capsys.readouterr().out
    for target in (folder, store):
        (found,) = [f for f in diagnose(target) if f.kind == "empty split"]
        assert found.severity == "error"
        assert "--fps 60" in found.fix


@pytest.mark.parametrize(
    ("reader", "option", "words"),
    [
        ("official", {"fps": 60}, r"fps is no option; reader official has none: features have the skeleton's rate"),
        ("synthetic", {"fps": 60}, r"fps is no option; reader synthetic"),
        ("joints", {"spilt": "x"}, r"spilt is no option; reader joints has fps, handed, order, scale, split, up"),
    ],
)
def test_an_option_that_a_reader_lacks_is_named(reader, option, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        read_corpus(reader, None if reader == "synthetic" else tmp_path, **option)


def test_the_rate_of_the_configuration_makes_another_store_and_the_usual_one_the_same(folder, tmp_path):
    def asked(*more: str) -> Path:
        return open_corpus(compose(["data=custom", f"data.source={folder}", f"paths.stores={tmp_path}/stores", *more]))

    usual = asked()
    assert PackedStore.open(asked("data.fps=20")).hash == PackedStore.open(usual).hash
    assert asked("data.options.up=y") != usual
    change_all(folder, lambda j: np.repeat(j, 3, axis=0))
    fast = asked("data.fps=60")
    assert PackedStore.open(fast).hash == PackedStore.open(usual).hash
    assert asked("data.fps=60") == fast
    (folder / "manifest.json").write_text(json.dumps([{"name": file.stem, "fps": 60} for file in files(folder)]))
    told, slow = (PackedStore.open(asked(*words)) for words in ((), ("data.fps=20",)))
    assert told.hash == PackedStore.open(fast).hash
    assert slow.hash != told.hash  # what is asked for comes before what the manifest says
    with pytest.raises(ValueError, match="fps='fast'; it must be a positive number"):
        asked("data.fps=fast")
    with pytest.raises(ValueError, match="fps is no option"):
        open_corpus(compose(["data=synthetic", "data.fps=60", f"paths.stores={tmp_path}/stores"]))


def test_a_command_lists_a_corpus_once_and_the_next_one_sees_what_has_changed(folder, tmp_path, monkeypatch):
    cfg = compose(["data=custom", f"data.source={folder}", f"paths.stores={tmp_path}/stores"])
    listed = []
    monkeypatch.setattr(
        "kinema.experiments.corpus.list_files", lambda source: listed.append(source) or list_files(source)
    )
    with files_listed_once():
        first = open_corpus(cfg)
        change_all(folder, lambda j: j[:-1])
        assert open_corpus(cfg) == first
    assert listed == [str(folder)]
    with files_listed_once():
        assert open_corpus(cfg) != first
    assert open_corpus(cfg) != first
    assert len(listed) == 3


@pytest.mark.parametrize(
    "words", [["train", "stage=tokenizer", "method=mdm"], ["reproduce", "table2", "--plan"]], ids=lambda w: w[0]
)
def test_every_command_lists_a_corpus_once(words, folder, tmp_path, monkeypatch):
    listed = []
    monkeypatch.setattr(
        "kinema.experiments.corpus.list_files", lambda source: listed.append(source) or list_files(source)
    )
    paths = [f"paths.{name}={tmp_path}/{name}" for name in ("stores", "runs", "cache")]
    assert cli.main([*words, "data=custom", f"data.source={folder}", "scale=smoke", *paths]) == 0
    assert listed == [str(folder)]
