"""The command line goes all the way: imported weights to a run folder, a run folder to files, one line per error."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from kinema import __version__, cli, interop
from kinema.cli import parser
from kinema.motion import body_parts
from kinema.motion.formats.arrays import load_npy, load_npz, save_npz
from kinema.motion.recording import read_recording
from kinema.motion.skeleton import HUMANML3D
from kinema.runs.folder import RunFolder
from kinema.text.manifest import read_manifest


def published_autoencoder() -> dict[str, torch.Tensor]:
    """Give a tiny MARDM autoencoder under its published names."""
    generator, state = torch.Generator().manual_seed(0), {}

    def conv(name, outputs, inputs, size):
        state[f"{name}.weight"] = 0.2 * torch.randn(outputs, inputs, size, generator=generator)
        state[f"{name}.bias"] = 0.2 * torch.randn(outputs, generator=generator)

    def blocks(name):
        for i in range(3):
            conv(f"{name}.model.{i}.conv1", 8, 8, 3)
            conv(f"{name}.model.{i}.conv2", 8, 8, 1)

    conv("encoder.model.0", 8, 67, 3)
    conv("decoder.model.0", 8, 6, 3)
    for level in (2, 3):
        conv(f"encoder.model.{level}.0", 8, 8, 4)
        blocks(f"encoder.model.{level}.1")
        blocks(f"decoder.model.{level}.0")
        conv(f"decoder.model.{level}.2", 8, 8, 3)
    conv("encoder.model.4", 6, 8, 3)
    conv("decoder.model.4", 8, 8, 3)
    conv("decoder.model.6", 67, 8, 3)
    return state


def published_generator() -> dict[str, torch.Tensor]:
    """Give a tiny MARDM under its published names."""
    from kinema.interop.mardm import export as published
    from kinema.runs.build import build

    torch.manual_seed(0)
    sizes = {
        "latent_dim": 6,
        "text_dim": 64,
        "width": 16,
        "feedforward": 32,
        "heads": 2,
        "mlp_width": 16,
        "mlp_depth": 2,
    }
    mlp = {"mlp_width": 16, "mlp_depth": 2}
    flow = {"_target_": "kinema.diffusion.flow.Flow"}
    return published(build({"_target_": "kinema.generators.mar.MARDM", "process": flow, **sizes, **mlp}))


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Give the folder of an imported generator, with its imported autoencoder beside it."""
    monkeypatch.chdir(tmp_path)
    np.save("Mean.npy", np.zeros(67))
    np.save("Std.npy", np.full(67, 0.1))
    torch.save({"ae": published_autoencoder(), "ep": 50}, "ae.tar")
    torch.save({"ema_mardm": published_generator(), "mardm": {}, "ep": 3}, "mardm.tar")
    assert cli.main(["import", "mardm-ae", "ae.tar", "--out", "runs/ae", "--statistics", "."]) == 0
    arguments = ["import", "mardm", "mardm.tar", "--out", "runs/mar", "--tokenizer", "runs/ae", "--text", "hashed"]
    assert cli.main([*arguments, "--set", "variant=sit", "--set", "heads=2"]) == 0
    return tmp_path / "runs" / "mar"


FAST = ["--set", "steps=2", "--set", "solver=euler", "--set", "solver_steps=2"]


def fails(capsys, arguments, *messages):
    capsys.readouterr()
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    for message in messages:
        assert message in captured.err


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


def test_what_is_decoded_raw_keeps_nothing_and_held_feet_are_said(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", "--frames", "40", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), "--keep", "0:20", *FAST]
    assert cli.main([*change, "--lock-feet", "--out", "edited.npz"]) == 0
    assert "kept frames 0:20 (but for feet that were held); largest step" in capsys.readouterr().out
    assert cli.main([*change, "--raw", "--out", "raw.npz"]) == 0
    assert "kept" not in capsys.readouterr().out
    assert load_npz("raw.npz").kept is None


def test_a_part_of_a_long_motion_is_taken(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--seed", "3", "--chain", "--seconds", "15", *FAST]
    assert cli.main([*make, "--out", "long.npz"]) == 0
    long = load_npz("long.npz")
    change = ["edit", "--motion", "long.npz", "--text", "someone sits", "--keep", "0:20", "--run", str(run), *FAST]
    fails(capsys, [*change, "--out", "edited.npz"], "allowed: 1 to 196 frames", "cut a part of it out (--part 0:196)")
    assert cli.main([*change, "--part", "5s:10s", "--out", "edited.npz"]) == 0
    assert "frames 100:200 of 300" in capsys.readouterr().out
    edited = load_npz("edited.npz")
    assert len(edited.joints) == 100
    assert np.array_equal(edited.features[:20], long.features[100:120])
    np.testing.assert_allclose(edited.joints[:20], long.joints[100:120], atol=1e-4)
    assert cli.main(["export", "long.npz", "--part", "140:160", "--out", "part.npz"]) == 0
    part = load_npz("part.npz")
    assert np.array_equal(part.joints, long.joints[140:160])
    assert np.array_equal(part.kept, long.kept[140:160])
    for wrong in ("0:10,20:30", "prefix", "290:310", "5"):
        fails(
            capsys, ["export", "long.npz", "--part", wrong, "--out", "none.npz"], wrong.partition(",")[0].split(":")[0]
        )


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


def test_joints_can_be_edited(run, capsys):
    from kinema.data.synthetic import synthetic_clips

    joints = next(iter(synthetic_clips(size=1, seed=0))).joints()[:61]
    np.save("captured.npy", joints.astype(np.float32))
    change = ["edit", "--motion", "captured.npy", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, "--regenerate", "suffix", "--out", "edited.npz"]) == 0
    edited = load_npz("edited.npz")
    assert edited.joints.shape == (61, HUMANML3D.num_joints, 3)
    capsys.readouterr()
    np.save("captured.npy", 1.2 * joints.astype(np.float32))
    assert cli.main([*change, "--keep", "prefix", "--out", "edited.npz"]) == 0
    told = re.search(r"note      kept joints get humanml3d's bones: up to (\d+) cm", capsys.readouterr().out)
    moved = np.linalg.norm(load_npz("edited.npz").joints[:30] - 1.2 * joints[:30], axis=-1).max()
    assert 1 < 100 * moved <= int(told[1]) + 1


@pytest.mark.parametrize("option", ["--keep", "--regenerate"])
@pytest.mark.parametrize(
    ("task", "stays"),
    [("prefix", "0:20"), ("suffix", "20:40"), ("inbetween", "0:10, 30:40"), ("outpaint", "10:30")],
)
def test_a_task_means_what_is_given_whichever_option_names_it(run, capsys, option, task, stays):
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, option, task, "--out", "edited.npz"]) == 0
    assert f"kept frames {stays}; largest step at a seam " in capsys.readouterr().out
    walk, edited = load_npz("walk.npz"), load_npz("edited.npz")
    same = (walk.features == edited.features).all(1)
    for span in stays.split(", "):
        start, end = map(int, span.split(":"))
        assert same[start:end].all()
        same[start:end] = False
    assert not same.any()


def test_keyframes_are_widened_to_latents_and_said(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    change = ["edit", "--motion", "walk.npz", "--text", "someone sits", "--run", str(run), *FAST]
    assert cli.main([*change, "--keep", "0:1,39:40", "--out", "edited.npz"]) == 0
    assert "kept frames 0:4, 36:40" in capsys.readouterr().out
    assert cli.main([*change, "--hold", "0,-1", "--out", "edited.npz"]) == 0
    told = capsys.readouterr().out
    assert "held      frames 0, 39, whole latents of 4 frames: within 0.0 cm of where they were" in told
    assert "kept frames 0:4, 36:40" in told
    fails(capsys, [*change, "--hold", "0", "--raw", "--out", "edited.npz"], "leave --raw out")


@pytest.mark.parametrize("width", [67, 100, 263])
def test_a_motion_with_narrower_rows_has_as_many_frames_and_stays_in_its_place(tmp_path, run, width):
    """A model of redundant dims reads 263 columns."""
    make = ["generate", "a person walks", "--run", str(run), "--frames", "40", "--seed", "3", *FAST]
    assert cli.main([*make, "--out", "walk.npz"]) == 0
    walk = load_npz("walk.npz")
    rows = np.zeros((40, width), np.float32)
    rows[:, :67] = walk.features
    save_npz(replace(walk, features=rows, joints=walk.joints + np.float32([5, 0, 1])), "moved.npz")
    read = read_recording("moved.npz").motion(HUMANML3D, 263)
    assert read.features.shape == (40, 263)
    assert np.array_equal(read.joints, walk.joints + np.float32([5, 0, 1]))
    assert np.array_equal(read.features[:, :67], walk.features)


def test_prepare_gives_a_store_that_opens(tmp_path, capsys):
    from kinema.data.store import PackedStore

    out = str(tmp_path / "store")
    for _ in range(2):
        assert cli.main(["prepare", "--format", "synthetic", "--out", out, "--set", "size=12", "--processes", "1"]) == 0
    store = PackedStore.open(out)
    assert store.num_clips == 24
    assert store.name == "synthetic"


def test_doctor_examines_what_prepare_wrote(tmp_path, capsys):
    out = str(tmp_path / "store")
    assert cli.main(["prepare", "--format", "synthetic", "--out", out, "--set", "size=12", "--processes", "1"]) == 0
    assert cli.main(["doctor", out]) == 0
    assert "doctor: " in capsys.readouterr().out
    fails(capsys, ["doctor", str(tmp_path / "nowhere")], "nowhere")


def test_doctor_examines_the_corpus_that_overrides_name(tmp_path, capsys):
    words = ["data=synthetic", "data.options.size=12", f"paths.stores={tmp_path}"]
    assert cli.main(["doctor", *words]) == 0
    assert "doctor: " in capsys.readouterr().out
    fails(capsys, ["doctor", str(tmp_path), "data=synthetic"], "doctor takes one path, or KEY=VALUE overrides")


def test_hydra_reads_the_words_behind_the_command_and_lightning_all(tmp_path, monkeypatch):
    """Processes of further devices are started with what sys.argv was, so the job has to see it whole."""
    seen = []

    def run_stage(cfg, stage):
        seen.append((stage, cfg.seed, sys.argv))
        return RunFolder(tmp_path)

    monkeypatch.setattr("kinema.experiments.run.run_stage", run_stage)
    words = ["kinema", "train", "stage=tokenizer", "seed=3"]
    monkeypatch.setattr(sys, "argv", words)
    assert cli.main() == 0
    assert seen == [("tokenizer", 3, words)]
    assert sys.argv == words


def test_info_without_a_run_says_what_a_bug_report_needs(capsys):
    assert cli.main(["info"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kinema"] == __version__
    assert {"python", "torch", "system"} <= set(said)


def test_figures_are_named(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["figures", "table5"])
    assert capsys.readouterr().err == "error: no figure table5; choose one of bad_masks, code_usage\n"
    with pytest.raises(SystemExit):
        cli.main(["figures", "code_usage", "--help"])
    assert "usage: kinema figures code_usage" in capsys.readouterr().out


def test_errors_are_one_line_and_exit_with_2(run, capsys):
    make = ["generate", "a person walks", "--run", str(run), "--out", "a.npz"]
    fails(capsys, make, "no length: give frames= or seconds=")
    fails(capsys, [*make, "--frames", "500"], "length 500 is out of range; allowed: 1 to 196")
    fails(capsys, [*make, "--frames", "8", "--set", "step=2"], "unknown sampling field 'step'; allowed: steps")
    fails(capsys, [*make, "--frames", "8", "--set", "steps"], "--set steps is no KEY=VALUE")
    fails(capsys, [*make[:-1], "a.gif", "--frames", "8"], "unknown suffix '.gif', choose one of .html")
    fails(capsys, ["generate", " ", "--run", str(run), "--out", "a.npz", "--frames", "8"], "text 0 is empty")
    fails(capsys, ["generate", "x", "--run", "runs/none", "--out", "a.npz"], "no run folder at runs/none")
    fails(capsys, ["generate", "x", "--run", "runs/ae", "--out", "a.npz"], "give the folder of a 'generator' run")
    fails(
        capsys,
        ["generate", "x", "--run", str(run), "--out", "a.npz", "--device", "nothing:0"],
        "device 'nothing:0' cannot be used here",
    )
    change = ["edit", "--motion", "none.npz", "--text", "x", "--run", str(run), "--out", "a.npz", "--regenerate"]
    fails(capsys, [*change, "0:4"], "none.npz is missing")
    fails(capsys, ["import", "mardm-ae", "none.tar", "--out", "runs/b"], "no checkpoint file at none.tar")
    fails(capsys, ["import", "mardm", "mardm.tar", "--out", "runs/b"], "mardm needs --tokenizer RUN")
    again = ["import", "mardm", "mardm.tar", "--out", "runs/b", "--tokenizer", "runs/ae"]
    fails(capsys, again, "'mardm' needs the option 'variant'")
    fails(capsys, ["import", "mardm-ae", "ae.tar", "--out", "runs/ae"], "runs/ae exists; choose another folder")
    fails(capsys, ["prepare", "--format", "joints", "--out", "store"], "--format joints needs SOURCE")
    fails(capsys, ["prepare", "none", "--format", "joints", "--out", "store"], "corpus folder none does not exist")
    fails(capsys, ["info", "runs/none"], "no weights at")
    assert not (run.parent / "b").exists()
    with pytest.raises(ValueError, match="no length"):
        cli.main([*make, "--debug"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--set guidance=2,5", "sampling.guidance=[2, 5]: must be a finite number >= 0"),
        ("--set guidance=high", "sampling.guidance=high: must be a finite number >= 0"),
        ("--set guidance=", 'sampling.guidance="": must be a finite number >= 0'),
        ("--set guidance=nan", "sampling.guidance=nan: must be a finite number >= 0"),
        ("--set guidance=1e999", "sampling.guidance=Infinity: must be a finite number >= 0"),
        ("--set guidance=null", "sampling.guidance=null: must be a finite number >= 0"),
        ("--set guidance=true", "sampling.guidance=true: must be a finite number >= 0"),
        ("--set steps=2.5", "sampling.steps=2.5: must be a whole number from 1"),
        ("--set steps=1e3", "sampling.steps=1000.0: must be a whole number from 1"),
        ("--set steps=many", "sampling.steps=many: must be a whole number from 1"),
        ("--set solver=fast", "sampling.solver=fast: must be one of ancestral, "),
        ("--set solver_steps=x", "sampling.solver_steps=x: must be a whole number from 1 to 100000 or counts such as"),
        ("--set clip_latents=maybe", "sampling.clip_latents=maybe: must be true or false"),
        ("--set frames=3", "unknown sampling field 'frames'; allowed: steps"),
        ("--set seed=3", "unknown sampling field 'seed'; allowed: steps"),
        ("--seed -1", "seed=-1: must be a whole number >= 0"),
        ("--seed 9223372036854775808", "seed=9223372036854775808: must be a whole number >= 0"),
    ],
)
def test_a_wrong_option_of_sampling_is_one_line(run, capsys, words, message):
    fails(capsys, ["generate", "x", "--run", str(run), "--out", "a.npz", "--frames", "8", *words.split()], message)


def test_a_wrong_length_or_number_of_processes_is_one_line(run, capsys):
    make = ["generate", "x", "--run", str(run), "--out", "a.npz"]
    for seconds, shown in (("inf", "Infinity"), ("nan", "NaN"), ("-inf", "-Infinity")):
        fails(capsys, [*make, f"--seconds={seconds}"], f"seconds={shown}: must be a finite number")
    change = ["edit", "--motion", "none.npz", "--text", "x", "--run", str(run), "--out", "a.npz", "--set", "motions=3"]
    fails(capsys, [*change, "--regenerate", "0:4"], "unknown sampling field 'motions'; allowed: steps")
    make = ["prepare", "--format", "synthetic", "--out", "store"]
    for processes in (-1, 0, 10**6):
        fails(capsys, [*make, "--processes", str(processes)], f"--processes={processes}: must be a whole number from 1")
    for given, message in (("size=many", "--set.size=many: must be a whole"), ("sizes=3", "--set.sizes is no option")):
        fails(capsys, [*make, "--set", given], message)


def test_an_autoencoder_without_statistics_says_so(run, capsys):
    assert cli.main(["import", "mardm-ae", "ae.tar", "--out", "runs/bare"]) == 0
    assert "import it with --statistics PATH" in capsys.readouterr().out


def test_help_needs_no_torch():
    code = "import sys; from kinema import cli\ntry: cli.main(['generate', '--help'])\nexcept SystemExit: pass\n"
    code += "assert not {'torch', 'numpy', 'lightning'} & sys.modules.keys()"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_the_choices_are_those_that_exist():
    assert set(parser.KINDS) == set(interop.KINDS)
    assert parser.PARTS == body_parts.PARTS


def test_values_that_begin_with_a_dash_are_values():
    assert cli._joined(["edit", "--hold", "-1,0", "--up", "-z", "--out", "x"]) == [
        "edit",
        "--hold=-1,0",
        "--up=-z",
        "--out",
        "x",
    ]
    assert cli._joined(["edit", "--hold", "--out"]) == ["edit", "--hold", "--out"]
