"""`kinema pack` makes one folder of a trained run that says where it is from, and whose commands make it again."""

from __future__ import annotations

import shlex
import shutil

import numpy as np
import pytest
from omegaconf import OmegaConf

from kinema import cli
from kinema.atomic import write_json
from kinema.cli.parser import command_line
from kinema.data.labels import read_label
from kinema.data.store import PackedStore
from kinema.data.synthetic import synthetic_clips, write_joints_folder
from kinema.experiments.config import compose, read_config
from kinema.experiments.corpus import open_corpus
from kinema.experiments.packing import figures, pack, strictest
from kinema.experiments.repertoires import foreign_sentences
from kinema.experiments.run import run_stage, stage_folder
from kinema.experiments.stages import get_stage
from kinema.pipeline import TextToMotion
from kinema.runs.lines import append_line


@pytest.fixture
def run(micro, shelf, monkeypatch):
    """Give a trained micro run of MARDM-SiT; stores and runs are found where the environment says."""
    for name in ("runs", "stores", "cache"):
        monkeypatch.setenv(f"KINEMA_{name.upper()}", str(shelf / name))
    return run_stage(compose([*micro, "method=mardm_sit"]), "generator").path


def test_a_packed_run_makes_the_run_s_motion_and_says_what_it_is(run, micro, tmp_path, capsys):
    assert cli.main(["pack", str(run), "--out", str(tmp_path / "small"), "--half"]) == 0
    said = capsys.readouterr().out
    assert "small (" in said
    packed = TextToMotion.from_pretrained(tmp_path / "small", "cpu")
    texts = ["a person walks forward", "a person jumps"]
    first, second = (one.generate(texts, 40, seed=1) for one in (TextToMotion.from_run(run, "cpu"), packed))
    assert max(np.abs(a.joints - b.joints).max() for a, b in zip(first, second, strict=True)) < 0.02
    card, known = packed.card, packed.repertoire
    assert (card.name, card.method, card.text_encoder) == ("small", "MARDM-SiT", packed.text_encoder.identity)
    assert card.licence == "that of the corpus"
    store = PackedStore.open(open_corpus(compose(micro)))
    assert store.hash in card.corpus
    clips = [clip for clip in store.split_clips("train") if not store.clips[clip]["mirrored"]]
    assert sum(known.clips.values()) == sum(known.styles.values()) == len(clips)
    assert f"it knows {len(known.clips)} actions in {len(known.styles)} styles" in said
    assert not any("/" in str(value) for value in card.settings.values())  # no path of this machine
    assert cli.main(["models", str(tmp_path / "small")]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in [*known.clips, *known.styles])


def test_the_commands_of_a_card_make_the_same_run(run, tmp_path):
    model = pack(run, tmp_path / "small", half=False, licence="CC BY 4.0")
    assert model.card.licence == "CC BY 4.0"
    train, packed = map(shlex.split, model.card.commands)
    assert train[:2] == ["kinema", "train"]
    assert "generator.train.steps=24" in train
    again = compose([word for word in train[2:] if not word.startswith("stage=")])
    assert stage_folder(again, get_stage("generator")).path == run
    command_line().parse_args(packed[1:])


@pytest.mark.parametrize("name", ["custom", "mine"])
def test_a_corpus_of_ones_own_is_packed(name, micro, shelf, tmp_path, monkeypatch):
    """The card's command leaves the folder open; the corpus that is read is the run's."""
    for kind in ("runs", "stores", "cache"):
        monkeypatch.setenv(f"KINEMA_{kind.upper()}", str(shelf / kind))
    folder = write_joints_folder(synthetic_clips(size=40, seed=len(name)), tmp_path / "corpus")
    others = [word for word in micro if not word.startswith("data")]
    own = ["data=custom", f"data.source={folder}", f"data.name={name}", "method=mardm_sit"]
    run = run_stage(compose([*others, *own]), "generator").path
    model = pack(run, tmp_path / "small", half=False, licence=None)
    assert model.card.corpus.startswith(f"{name} (")
    train = shlex.split(model.card.commands[0])
    assert str(tmp_path) not in model.card.commands[0]
    again = [f"data.source={folder}" if word == "data.source=FOLDER" else word for word in train[2:]]
    again = compose([word for word in again if not word.startswith("stage=")])
    assert stage_folder(again, get_stage("generator")).path == run


def test_a_scale_of_ones_own_is_packed_without_a_command(run, tmp_path, monkeypatch, capsys):
    theirs = OmegaConf.merge(read_config(run), {"scale": {"name": "my_own"}})
    monkeypatch.setattr("kinema.experiments.packing.read_config", lambda folder: theirs)
    model = pack(run, tmp_path / "small", half=False, licence=None)
    told = " ".join(capsys.readouterr().out.split())
    assert "the card will not say how to train this again: scale=my_own is no option" in told
    assert model.card.commands == []
    assert "kinema train" not in (tmp_path / "small" / "README.md").read_text()


def test_figures_are_those_of_the_run_s_own_sampling(run, micro, tmp_path):
    own = tmp_path / "generator" / run.name  # apart from the runs that tests share
    shutil.copytree(run, own)
    cfg = compose([*micro, "method=mardm_sit", "source=generation"], "evaluate")
    sampling = {**compose([*micro, "method=mardm_sit"]).generator.sampling}
    other = {"statistics": {"evaluator": {"kind": "redundant"}}}
    for name, changed, rest, fid in (("1", {}, {}, 2.0), ("2", {"guidance": 9.0}, {}, 1.0), ("3", {}, other, 7.0)):
        folder = tmp_path / "evaluation" / f"generation-{name}"
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text(OmegaConf.to_yaml(cfg, resolve=True))
        write_json(folder / "status.json", {"state": "done"})
        rests = {"runs": {"generator": run.name}, "sampling": sampling | changed, "protocol": {"split": "val"}}
        rests |= rest
        line = {"metrics": {"fid": fid, "r1": 0.5}, "breakdowns": {}, "provenance": rests, "seconds": 1.0}
        for replication in range(2):
            append_line(folder / "replications.jsonl", {"replication": replication, **line})
    (found,) = figures(own)
    assert found["split"] == "val"
    assert found["scores"] == {"R@1": "0.500 ± 0.000", "FID": "2.000 ± 0.000", "replications": "2"}
    words = shlex.split(found["command"])
    assert words[:3] == ["kinema", "evaluate", "source=generation"]
    compose(words[2:], "evaluate")


def test_what_cannot_be_packed_is_one_line(run, tmp_path, capsys):
    def fails(words, message):
        assert cli.main(["pack", *map(str, words)]) == 2
        assert message in capsys.readouterr().err

    (tmp_path / "there").mkdir()
    fails([run, "--out", tmp_path / "there"], "there exists; choose another folder, or --replace")
    fails(["runs/none", "--out", tmp_path / "new"], "no run folder at runs/none")
    saved = TextToMotion.from_run(run, "cpu").save(tmp_path / "saved")
    fails([saved, "--out", tmp_path / "new"], "has no config.yaml")
    assert not (tmp_path / "new").exists()


def test_the_strictest_licence_is_the_weights():
    assert strictest(["CMU", "CC BY-NC 4.0", "CC BY-SA 3.0"]) == "CC BY-NC 4.0"
    assert strictest(["MIT", "MIT"]) == "MIT"
    assert strictest(["CMU", "CC BY-SA 3.0"]) == strictest([]) == "that of the corpus"
    assert strictest(["CC BY-NC 4.0", "CC BY-NC-ND 4.0"]) == "that of the corpus"  # neither binds as the other does


@pytest.mark.parametrize(
    ("label", "action", "style"),
    [
        ("raise-up-left-hand|youthful", "raise up left hand", "youthful"),
        ("walk-back|not-confident", "walk back", "not confident"),
        ("dance - small jetes, turn", "dance", None),
        ("jogLeftCircle4StepsRstart", "jog left circle 4 steps rstart", None),
        ("kickLFront1Reps", "kick l front 1 reps", None),
        ("salsa dance", "salsa dance", None),
    ],
)
def test_labels_are_read_as_words(label, action, style):
    assert read_label(label) == (action, style)


def test_foreign_sentences_are_texts():
    assert len(set(foreign_sentences())) == len(foreign_sentences()) > 60
