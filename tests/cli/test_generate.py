"""`kinema generate`: imported weights to files, of one prompt and of many, each of which can be made again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from tests.cli.conftest import FAST, fails

from kinema import __version__, cli
from kinema.motion.formats.arrays import load_npy, load_npz
from kinema.motion.skeleton import HUMANML3D
from kinema.text.manifest import read_manifest


def test_generate_edit_and_look(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", *FAST]
    assert cli.main([*make, "--seconds", "2", "--out", "walk.npz"]) == 0
    assert "wrote walk.npz (40 frames, seed 3)" in capsys.readouterr().out
    walk = load_npz("walk.npz")
    assert walk.features.shape == (40, 67)
    assert cli.main([*make, "--frames", "40", "--lock-feet", "--out", "held.npz"]) == 0
    assert "feet      skating" in capsys.readouterr().out
    assert np.array_equal(load_npz("held.npz").features[:, :4], walk.features[:, :4])
    assert cli.main([*make, "--frames", "40", "--out", "walk.html"]) == 0
    assert "a person walks" in Path("walk.html").read_text()
    make.insert(2, "someone sits")
    assert cli.main([*make, "--chain", "--frames", "40", "--out", "long.npz"]) == 0
    assert len(load_npz("long.npz").features) == 40 + 2 * 4 + 40
    told = capsys.readouterr().out
    assert "seam      2.0 s (frames 40:48): largest step " in told
    assert "elsewhere largest step " in told
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), "--seed", "4", *FAST]
    for which in (["--regenerate", "0.5s:1s"], ["--keep", ":10,20:"]):
        assert cli.main([*change, *which, "--out", "edited.npz"]) == 0
        edited = load_npz("edited.npz")
        assert edited.text == "someone sits"
        assert np.array_equal(edited.features[:10], walk.features[:10])
        assert np.array_equal(edited.features[20:], walk.features[20:])
        assert np.abs(edited.features[10:20] - walk.features[10:20]).max() > 1e-3
    capsys.readouterr()
    for which, message in (
        ([], "give --regenerate RANGES"),
        (["--parts", "upper"], "needs a method that generates frames"),
    ):
        assert cli.main([*change, *which, "--out", "none.npz"]) == 2
        assert message in capsys.readouterr().err
    assert cli.main(["info", str(run)]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described["artifact"]["kinema"] == __version__
    assert described["text"]["encoder"] == "hashed"
    assert described["upstream"] == {"tokenizer": "../ae"}


def test_a_length_out_of_range_names_the_line_of_its_prompt(run, capsys):
    make = ["generate", "--run", str(run), "--frames", "8", *FAST]
    for name, text, line in (
        ("p.csv", "text,frames\na man bows,\na person walks,500\n", 3),
        ("p.csv", "text,seconds\na person walks,0.01\n", 2),
        ("p.jsonl", '{"text": "a man bows"}\n\n{"text": "a person walks", "seconds": 60}\n', 3),
        ("p.txt", "a man bows\na person walks#500\n", 2),
    ):
        Path(name).write_text(text)
        fails(capsys, [*make, "--prompts", name, "--out", "m.npz"], f"{name}, line {line}: length ")
    fails(
        capsys, ["generate", "a", "--run", str(run), "--chain", "--seconds", "9999999", "--out", "m.npz"], "allowed: 1"
    )
    assert "--chain" not in capsys.readouterr().err


def test_one_text_is_chained_to_itself_beyond_the_longest_motion(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seconds", "15", *FAST]
    fails(capsys, [*make, "--out", "long.npz"], "longer ones are made of parts (--chain")
    assert cli.main([*make, "--chain", "--out", "long.npz"]) == 0
    assert "parts     2 of 148, 144 frames" in capsys.readouterr().out
    long = load_npz("long.npz")
    assert len(long.features) == 300
    assert np.flatnonzero(~long.kept).tolist() == list(range(148, 156))
    assert long.text == "a person walks"


def test_several_texts_give_several_files_or_one_page(run):
    make = ["generate", "a person walks", "a man bows", "--run", str(run), "--frames", "8", *FAST]
    assert cli.main([*make, "--out", "all.html"]) == 0
    assert cli.main([*make, "--out", "clip.npy"]) == 0
    assert load_npy("clip-2.npy").shape == (8, 22, 3)


def test_a_text_gives_as_many_motions_as_are_asked_for(run, capsys):
    make = ["generate", "a person walks", "a man bows", "--run", str(run), "--frames", "8", "--seed", "1", *FAST]
    assert cli.main([*make, "--count", "2", "--out", "m.npz"]) == 0
    made = [load_npz(f"m-{i}.npz") for i in (1, 2, 3, 4)]
    assert [motion.text for motion in made] == ["a person walks"] * 2 + ["a man bows"] * 2
    assert [motion.seed for motion in made] == [1, made[1].seed] * 2
    assert not np.array_equal(made[0].joints, made[1].joints)
    fails(capsys, [*make, "--count", "0", "--out", "m.npz"], "count=0: must be a whole number from 1")
    fails(capsys, [*make, "--count", "2", "--chain", "--out", "m.npz"], "--count 2 with --chain")
    fails(capsys, [*make, "--batch-size", "32", "--chain", "--out", "m.npz"], "--batch-size 32 with --chain")
    fails(capsys, [*make, "--batch-size", "0", "--out", "m.npz"], "batch_size=0: must be a whole number from 1")


def test_a_table_of_prompts_says_length_count_and_seed(run, capsys):
    Path("p.csv").write_text('text,seconds,count,seed\n"a person walks, slowly",0.5,,9\na man bows,,2,\n')
    make = ["generate", "--prompts", "p.csv", "--run", str(run), "--seed", "4", "--frames", "8", *FAST]
    assert cli.main([*make, "--out", "m.npz"]) == 0
    made = [load_npz(f"m-{i}.npz") for i in (1, 2, 3)]
    assert [motion.text for motion in made] == ["a person walks, slowly", "a man bows", "a man bows"]
    assert [len(motion.joints) for motion in made] == [10, 8, 8]
    assert [motion.seed for motion in made[:2]] == [9, 4]
    fails(capsys, [*make, "--chain", "--out", "m.npz"], "--chain makes one motion of all prompts, of one --seed")
    Path("p.csv").write_text("text,frames\na person walks,500\n")
    fails(capsys, [*make, "--out", "m.npz"], "length 500 is out of range")


def test_many_motions_are_named_and_each_is_made_again_from_its_line_alone(run, capsys):
    Path("p.csv").write_text("text,name,frames\na person walks,w,16\nSomeone bows!,b,40\n")
    make = ["generate", "--run", str(run), *FAST, "--seed", "5", "--count", "2"]
    out = "made/{name}/{index:02d}-{slug}-{take}-{seed}.npz"
    assert cli.main([*make, "--prompts", "p.csv", "--out", out]) == 0
    entries = read_manifest("made/manifest.jsonl")
    assert [entry.file.rpartition("-")[0] for entry in entries] == [
        "w/01-a-person-walks-1",
        "w/02-a-person-walks-2",
        "b/03-someone-bows-1",
        "b/04-someone-bows-2",
    ]
    lines = Path("made/manifest.jsonl").read_text().splitlines()
    for entry, line in zip(entries, lines, strict=True):
        Path("one.jsonl").write_text(line)
        again = ["generate", "--prompts", "one.jsonl", "--run", str(run), *FAST, "--out", "again.npz"]
        assert cli.main(again) == 0
        first, second = load_npz(f"made/{entry.file}"), load_npz("again.npz")
        assert second.seed == entry.seed
        assert first.joints.shape == second.joints.shape == (entry.frames, 22, 3)
        assert np.abs(first.joints - second.joints).max() < 1e-5  # another batch: the draws are the same, bits are not
    fails(capsys, [*again, "--set", "guidance=9"], "was made with --set guidance=", "give these")
    for more in (["--count", "2"], ["--frames", "8"], ["--seconds", "1"]):
        fails(capsys, [*again, *more], "--count, --frames and --seconds would make other motions")
    Path("one.jsonl").write_text(lines[0].replace(entries[0].model, "0" * 12))
    fails(capsys, again, "was made by mar (model 000000000000), and this is model", "give its --run")


def test_what_is_interrupted_leaves_a_line_for_every_file(run, capsys):
    Path("made/2.npz").mkdir(parents=True)  # so that the second file of the batch can't be written
    make = ["generate", "a person walks", "--count", "3", "--run", str(run), *FAST, "--frames", "8", "--seed", "1"]
    fails(capsys, [*make, "--out", "made/{index}.npz"], "made/2.npz")
    assert [entry.file for entry in read_manifest("made/manifest.jsonl")] == ["1.npz"]


def test_motions_made_one_by_one_come_again_bit_by_bit(run):
    make = ["generate", "a person walks", "a man bows", "--run", str(run), *FAST, "--frames", "16"]
    assert cli.main([*make, "--seed", "5", "--batch-size", "1", "--out", "made/{index}.npz"]) == 0
    Path("one.jsonl").write_text(Path("made/manifest.jsonl").read_text().splitlines()[1])
    assert cli.main(["generate", "--prompts", "one.jsonl", "--run", str(run), *FAST, "--out", "again.npz"]) == 0
    assert np.array_equal(load_npz("made/2.npz").joints, load_npz("again.npz").joints)


def test_names_that_cannot_be_are_refused_before_anything_is_made(run, capsys):
    make = ["generate", "a person walks", "a man bows", "--run", str(run), *FAST, "--frames", "8"]
    fails(capsys, [*make, "--out", "made/{sed}.npz"], "{sed} is nothing that a motion has; it may hold {index}, {slug}")
    fails(capsys, [*make, "--seed", "1", "--out", "made/{seed}.npz"], "calls two motions made/1.npz", "add {index}")
    fails(capsys, [*make, "--out", "made/{index}.xyz"], "unknown suffix '.xyz'")
    fails(capsys, [*make, "--out", "made/{index}.npz", "--chain"], "name one file without braces")
    Path("made").mkdir()
    Path("made/manifest.jsonl").write_text("{}\n")
    fails(capsys, [*make, "--out", "made/{index}.npz"], "made/manifest.jsonl, line 1 has 'file': it holds null")
    assert [path.name for path in Path("made").iterdir()] == ["manifest.jsonl"]


def test_a_file_that_cannot_be_written_is_told_before_anything_is_made(run, capsys, monkeypatch):
    """FBX without Blender: whichever way a motion is made, the model is not asked."""
    Path("way.csv").write_text("x,z\n0,0\n0,1\n")
    Path("two.txt").write_text("a person walks#40\nsomeone sits#40\n")
    np.save("clip.npy", HUMANML3D.ancestry[None].repeat(40, 0)[..., :3].astype(np.float32))
    monkeypatch.setenv("KINEMA_BLENDER_PYTHON", "nowhere/python")
    for name in ("generate", "chain", "edit"):
        monkeypatch.setattr(f"kinema.pipeline.TextToMotion.{name}", None)
    make = ["generate", "a person walks", "--run", str(run), "--out", "walk.fbx"]
    change = ["edit", "--motion", "clip.npy", "--text", "sits", "--run", str(run), "--out", "walk.fbx"]
    for words in (
        [*make, "--frames", "40"],
        [*make, "--frames", "40", "--chain"],
        [*make, "--path", "way.csv"],
        [*make[:-1], "{index}.fbx", "--frames", "40", "--count", "2"],
        [make[0], "--prompts", "two.txt", *make[2:]],
        [*change, "--keep", "0:20"],
        [*change, "--hold", "0,-1"],
    ):
        fails(capsys, words, "KINEMA_BLENDER_PYTHON=nowhere/python does not run")
