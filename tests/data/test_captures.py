"""Folders of captures become corpora: takes cut as a table says, or in pieces; what cannot be read is left out."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from tests.motion.captures.conftest import bvh_text

from kinema import cli
from kinema.data import captures
from kinema.data.captures import read_captures
from kinema.data.doctor import diagnose
from kinema.data.prepare import prepare, prepare_store
from kinema.data.store import PackedStore
from kinema.data.synthetic import synthetic_clips
from kinema.motion.convention import Convention
from kinema.motion.recording import read_recording

SECONDS = 12


def swaying(seed: int) -> str:
    """Write a take of a body that sways, at 30 frames per second."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-12, 12, (1, 22, 3)) * np.sin(np.arange(SECONDS * 30) / 9)[:, None, None]
    return bvh_text(angles)


@pytest.fixture
def folder(tmp_path):
    """Give a folder of four takes, one of them in a folder of its own."""
    (tmp_path / "takes/day two").mkdir(parents=True)
    for i, name in enumerate(("a", "b", "c", "day two/a")):
        (tmp_path / "takes" / f"{name}.bvh").write_text(swaying(i))
    return tmp_path / "takes"


def table(folder, *rows: str) -> str:
    file = folder.parent / "captions.csv"
    file.write_text("\n".join(("file,start,end,caption,split", *rows)) + "\n")
    return str(file)


def test_a_table_says_what_is_cut_out_and_what_is_said_of_it(folder, tmp_path):
    rows = ("b,0,4,somebody sways,train", "b.bvh,0,4,a person wiggles,train", "b,6.5,,they sway again,train")
    catalog = read_captures(folder, captions=table(folder, *rows, "day two/a,,,one bows # twice,test"))
    first, second, other = catalog
    assert [c.caption.text for c in first.captions] == ["somebody sways", "a person wiggles"]
    assert other.captions[0].caption.text == "one bows # twice"
    whole = read_recording(folder / "b.bvh").joints
    np.testing.assert_array_equal(first.joints(), whole[:80])
    np.testing.assert_array_equal(second.joints(), whole[130:])
    assert (second.origin.take, second.origin.start, second.origin.stop) == ("b", 130, len(whole))
    assert [c.split for c in catalog] == ["train", "train", "test"]
    assert "SMPL, 30 fps, y up" in catalog.rate
    store = PackedStore.open(prepare(catalog, tmp_path / "store", name="mine", mirror=False))
    assert store.num_clips == 3


def test_without_a_table_takes_are_cut_in_pieces_and_none_straddles_two_splits(folder):
    catalog = read_captures(folder)
    assert [len(c.joints()) for c in catalog if c.origin.take == "a"] == [180, SECONDS * 20 - 180]
    assert not any(c.captions for c in catalog)
    splits = {take: {c.split for c in catalog if c.origin.take == take} for take in ("a", "b", "c", "day two/a")}
    assert all(len(found) == 1 for found in splits.values())
    assert len({c.name for c in catalog}) == len(catalog.clips) == 8


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("x,0,2,a,", "row 2: file 'x' names no take"),
        (",0,2,a,", "row 2: file '' names no take"),
        ("b,2,1,a,", "row 2: end 1 is not after start 2"),
        ("b,0,0,a,", "row 2: end 0 is not after start 0"),
        ("b,-1,2,a,", "row 2: '-1' is no time"),
        ("b,nan,2,a,", "row 2: 'nan' is no time"),
        ("b,soon,2,a,", "row 2: 'soon' is no time"),
        ("b,0,2,a#b/NOUN#c,", "row 2: caption line .* has three fields"),
        ("b,0,2,a,training", "row 2: split 'training'; choose one of train, val, test"),
        ("b,0,2,a,train\nb,3,5,b,test", "row 3: b is in 'train' above; a take belongs to one split"),
    ],
)
def test_a_wrong_row_is_named(folder, row, told):
    with pytest.raises(ValueError, match=told):
        read_captures(folder, captions=table(folder, row))


def test_cuts_that_begin_together_and_takes_that_are_spelled_alike_are_told_apart(folder):
    catalog = read_captures(folder, captions=table(folder, "b,0,2,a,", "b,0,4,b,", "b,,,c,"))
    assert len({clip.name for clip in catalog}) == 3
    (folder / "day_two").mkdir()
    (folder / "day_two/a.bvh").write_text(swaying(8))
    with pytest.raises(ValueError, match="'day two/a' and 'day_two/a' would make clips of one name"):
        read_captures(folder)


@pytest.mark.parametrize(
    ("one", "other"), [(",", "0,{end}"), ("0,3.01", "0,3.02"), ("0,3.01", "0.02,3"), ("6,", "6.01,{end}")]
)
def test_seconds_that_are_the_same_frames_are_one_clip_with_the_captions_of_both(folder, tmp_path, one, other):
    end = len(read_recording(folder / "b.bvh").joints) / 20 + 0.01
    rows = (f"b,{one},somebody sways,train", f"b,{other.format(end=end)},they wiggle,train", "b,7,9,they stop,train")
    catalog = read_captures(folder, captions=table(folder, *rows))
    assert [[c.caption.text for c in clip.captions] for clip in catalog] == [
        ["somebody sways", "they wiggle"],
        ["they stop"],
    ]
    store = prepare(catalog, tmp_path / "store", name="mine", mirror=False)
    assert not [f for f in diagnose(store) if f.kind == "duplicate names"]


def test_a_suffix_may_be_in_any_case_and_two_takes_of_one_name_are_refused(folder):
    for name, other in (("a.bvh", "a.BVH"), ("b.bvh", "b.Bvh")):
        (folder / name).rename(folder / other)
    assert {clip.fields["take"] for clip in read_captures(folder)} == {"a", "b", "c", "day two/a"}
    assert read_captures(folder, captions=table(folder, "b.bvh,0,2,a,")).clips[0].fields["take"] == "b"
    (folder / "c.BVH").write_text(swaying(9))
    with pytest.raises(ValueError, match=r"holds c\.BVH and c\.bvh, takes of one name; rename one"):
        read_captures(folder)


def test_a_name_of_several_takes_needs_its_path(folder):
    (folder / "day three").mkdir()
    (folder / "day three/c2.bvh").write_text(swaying(5))
    (folder / "day two/c2.bvh").write_text(swaying(6))
    with pytest.raises(ValueError, match="is the name of 2 takes: write its path"):
        read_captures(folder, captions=table(folder, "c2,0,2,a,"))
    assert len(read_captures(folder, captions=table(folder, "day two/c2,0,2,a,"))) == 1


def test_takes_that_cannot_be_read_and_cuts_beyond_an_end_are_left_out_with_the_reason(folder, tmp_path, capsys):
    (folder / "broken.bvh").write_text(swaying(7)[:900])
    (folder / "._a.bvh").write_bytes(b"\0\5\x16\7")
    words = ["prepare", str(folder), "--format", "bvh", "--out", str(tmp_path / "store"), "--processes", "1"]
    assert cli.main(words) == 0
    assert "broken" in capsys.readouterr().out
    rows = [f"{take},0,4,a person sways," for take in ("a", "b", "c", "day two/a")]
    late = table(folder, *rows, "c,10,15,too late,")
    assert cli.main([*words[:5], str(tmp_path / "late"), "--captions", late]) == 0
    assert f"c.bvh ends after {SECONDS:.1f} s" in capsys.readouterr().out


def test_takes_that_cannot_be_read_count_among_those_that_are_refused(folder, tmp_path, capsys):
    whole = len(read_captures(folder))
    for number in range(whole):
        (folder / f"broken{number}.bvh").write_text(swaying(7)[:900])
    words = ["prepare", str(folder), "--format", "bvh", "--out", str(tmp_path / "store"), "--processes", "1"]
    assert cli.main(words) == 2
    told = capsys.readouterr().err
    assert f"{whole} of {2 * whole} clips are unusable, more than the allowed share 0.2" in told
    assert "--set max_unusable=SHARE" in told
    assert cli.main([*words, "--set", "max_unusable=0.5"]) == 0


def test_another_table_is_another_corpus(folder, tmp_path):
    def asked(*rows: str) -> str:
        options = {"captions": table(folder, *rows)}
        return prepare_store("captures", folder, tmp_path / "stores", name="x", **options).name

    first = asked("a,0,4,a person sways,train", "b,0,4,b,val", "c,0,4,c,test")
    assert asked("a,0,4,somebody else,train", "b,0,4,b,val", "c,0,4,c,test") != first


def test_what_a_format_lacks_is_said(folder, tmp_path, capsys):
    np.savez(folder / "pose.npz", poses=np.zeros((40, 156)), trans=np.zeros((40, 3)), mocap_framerate=np.array(120.0))
    assert cli.main(["prepare", str(folder), "--format", "amass", "--out", str(tmp_path / "s")]) == 2
    assert "say where it is (--smplh FOLDER)" in capsys.readouterr().err
    assert cli.main(["prepare", str(folder), "--format", "amc", "--out", str(tmp_path / "s")]) == 2
    assert "holds no *.amc" in capsys.readouterr().err
    assert cli.main(["prepare", str(folder), "--format", "bvh", "--order", "limbs", "--out", str(tmp_path / "s")]) == 2
    assert "order is no option; reader captures has captions" in capsys.readouterr().err


def test_a_sheet_shows_what_was_understood(folder, tmp_path, capsys):
    rows = [f"{take},0,4,a person <b>sways</b>," for take in ("a", "b", "c", "day two/a")]
    words = ["prepare", str(folder), "--format", "bvh", "--captions", table(folder, *rows)]
    assert cli.main([*words, "--out", str(tmp_path / "store"), "--processes", "1"]) == 0
    cli.main(["doctor", str(tmp_path / "store"), "--sheet", str(tmp_path / "sheet.html")])
    assert f"wrote {tmp_path}/sheet.html" in capsys.readouterr().out
    page = (tmp_path / "sheet.html").read_text()
    assert page.count("data-frames=") == 4  # no mirror images
    assert "day_two_a" in page
    assert "a person &lt;b&gt;sways" in page
    assert cli.main(["doctor", str(tmp_path / "store"), "--sheet", "sheet.pdf"]) == 2
    assert "name an .html file" in capsys.readouterr().err


def test_a_sheet_of_one_file_shows_it_however_wrong_it_is(tmp_path):
    lying = write_upturned(tmp_path / "clip.npy")
    assert cli.main(["doctor", str(lying), "--sheet", str(tmp_path / "sheet.html")]) == 1
    assert "clip.npy" in (tmp_path / "sheet.html").read_text()


def write_upturned(file):
    """Write a clip whose Y is no upward axis."""
    joints = next(iter(synthetic_clips(size=1, seed=3))).joints()
    np.save(file, joints[..., [0, 2, 1]] * [1, -1, 1])
    return file


def test_a_corpus_of_captures_is_known_by_its_files_and_not_by_how_a_machine_rounds(folder, tmp_path, monkeypatch):
    def hashed(root, **options: object) -> str:
        catalog = read_captures(root, **options)
        return PackedStore.open(prepare(catalog, tmp_path / str(len(list(tmp_path.iterdir()))), name="mine")).hash

    usual, copied = hashed(folder), tmp_path / "copied"
    shutil.copytree(folder, copied)
    read = captures.captured_joints
    with monkeypatch.context() as patch:
        patch.setattr(captures, "captured_joints", lambda *a, **k: (read(*a, **k)[0] * 1.0001, read(*a, **k)[1]))
        assert hashed(copied) == usual
    assert hashed(folder, scale=1.01) != usual
    (copied / "a.bvh").write_text(swaying(7))
    assert hashed(copied) != usual


def test_what_a_take_is_read_with_is_part_of_what_it_is(tmp_path):
    source = captures.Source(
        tmp_path / "takes/01_01.amc", Convention(mapping=str(tmp_path / "map.yaml")), tmp_path / "smplh"
    )
    (tmp_path / "takes").mkdir()
    (tmp_path / "smplh").mkdir()
    files = [source.path, source.path.with_name("01.asf"), tmp_path / "smplh/model.npz", tmp_path / "map.yaml"]
    for file in files:
        file.write_text(file.name)
    known = {source.identity()}
    for file in files:
        file.write_text("another content")
        known.add(source.identity())
    assert len(known) == len(files) + 1
