"""Bad input at the level where the user meets it: one clear error, exit code 2, no traceback, nothing damaged."""

from __future__ import annotations

import json
import pickle
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from kinema.data.synthetic import synthetic_clips
from kinema.data.synthetic.folders import write_joints_folder
from kinema.experiments.config import compose
from kinema.experiments.run import run_stage
from kinema.pipeline import TextToMotion
from kinema.runs import weights
from kinema.runs.folder import RunFolder
from kinema.training.checkpoint import AtomicCheckpointIO

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["data=custom", "data.mirror=false", "generator.train.batch_size=4", "tokenizer.train.steps=2"]


@pytest.fixture
def refused(overrides, monkeypatch, capfd) -> Callable[..., str]:
    """Run train.py or evaluate.py in this process; they must end with exit code 2 and one message, which is given."""

    def run(name: str, *arguments: str) -> str:
        monkeypatch.chdir(ROOT)
        given = [o for o in overrides if "data=custom" not in arguments or not o.startswith("data")]
        monkeypatch.setattr("sys.argv", [name, *given, *arguments])
        capfd.readouterr()
        with pytest.raises(SystemExit) as stopped:
            runpy.run_path(name, run_name="__main__")
        message = capfd.readouterr().err
        assert stopped.value.code == 2
        assert "Traceback" not in message
        return message

    return run


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Path:
    """Give a sound joints folder of a few clips."""
    return write_joints_folder(synthetic_clips(size=30, seed=0), tmp_path_factory.mktemp("corpus") / "whole")


@pytest.fixture
def corpus(whole, tmp_path) -> Path:
    """Give a copy of the sound folder to be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "corpus"))


def clip_of(corpus: Path, split: str = "train") -> Path:
    return corpus / "joints" / f"{(corpus / f'{split}.txt').read_text().split()[0]}.npy"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["data=open_mocp"], ["error: data=open_mocp is no option; data has custom, humanml3d, kit_ml, open_mocap"]),
        (["scale=huge"], ["huge", "paper", "smoke", "tiny"]),
        (["generator.train.stepz=3"], ["generator.train.stepz is no option; generator.train has batch_size, betas"]),
        (["logger.gruop=x"], ["error: logger.gruop is no option; logger has artifacts, group, mode, names, project"]),
        (["+logger.team=x"], ["error: logger.team is no option; logger has artifacts, group, mode, names, project"]),
        (["+trainer.deterministic=true"], ["error: trainer.deterministic is no option; trainer has accelerator"]),
        (["metod=mmm"], ["error: metod is no option; the configuration has callbacks, data"]),
        (["generator.train.lr"], ["error: ", "missing EQUAL"]),
        (["+generator.train.stepz=3"], ["error: generator.train.stepz is no option; a recipe has batch_size", "steps"]),
        (["+tokenizer.train.stepz=3"], ["error: tokenizer.train.stepz is no option"]),
        (["+length.model.widht=3"], ["widht", "its arguments are"]),
        (["+generator.sampling.guidence=3"], ["guidence", "its arguments are", "guidance"]),
        (["tokenizer.train.data=clip"], ["error: tokenizer.train.data=clip: must be one of windows, clips"]),
        (["stage=generater"], ["stage='generater' is unknown; allowed: contrastive, decomposition"]),
        (["seed=-1"], ["seed=-1: must be a whole number >= 0"]),
        (["seed=true"], ["error: seed=true: must be a whole number"]),
        (
            ["generator.sampling.guidance=high"],
            ["error: generator.sampling.guidance=high: must be a finite number"],
        ),
        (["generator.sampling.guidance=nan"], ["error: generator.sampling.guidance=NaN: must be a finite"]),
        (["diffusion.sampling.steps=x"], ["error: generator.sampling.solver_steps=x: must be a whole number"]),
        (["generator.train.ema=2"], ["error: generator.train.ema=2: must be a finite number >= 0 and < 1 or null"]),
        (["generator.train.warmup=-5"], ["error: generator.train.warmup=-5: must be a whole number from 0"]),
        (["+generator.train.clip=-1"], ["error: generator.train.clip=-1: must be a finite number > 0 or null"]),
        (["generator.train.steps=1e3"], ["error: generator.train.steps=1000.0: must be a whole number"]),
        (["generator.model.layers=-1"], ["error: generator.model.layers=-1: must be a whole number from 1"]),
        (["generator.model.width=wide"], ["error: generator.model.width=wide: must be a whole number"]),
        (
            ["generator.model.width=1000000000"],
            ["generator.model.width=1000000000: must be a whole number from 1"],
        ),
        (["generator.model.condition_drop=3"], ["error: generator.model.condition_drop=3: must be"]),
        (["length.model.classes=many", "length.train.steps=1"], ["error: length.model.classes=many: must be"]),
        (["tokenizer.model.dropout=no"], ["error: tokenizer.model.dropout=no: must be a finite number"]),
        (["scale.protocol.replications=0"], ["error: scale.protocol.replications=0: must be a whole number from 1"]),
        (["scale.threads=many"], ["error: scale.threads=many: must be a whole number"]),
        (["data.workers=-1"], ["error: data.workers=-1: must be a whole number from 0"]),
        (["data.options.size=some"], ["error: data.options.size=some: must be a whole number"]),
        (["+data.options.sizes=3"], ["error: data.options.sizes is no option; reader synthetic has"]),
        (["logger.artifacts=maybe"], ["error: logger.artifacts=maybe: must be true or false"]),
        (["callbacks.samples_every=often"], ["error: callbacks.samples_every=often: must be a whole number"]),
        (["data=custom"], ["error: config: Missing mandatory value", "set data.source"]),
        (["trainer.progress=loud"], ["trainer.progress=loud: must be one of rich, tqdm, none"]),
        (["trainer.accelerator=tpux"], ["trainer.accelerator=tpux: must be one of auto, gpu, cuda, mps, cpu"]),
        (
            ["logger.names=[tensorbord]"],
            ['logger.names=["tensorbord"]: must be a list, each one of csv'],
        ),
        (["stage=tokenizer", "tokenizer.train.steps=many"], ["error: tokenizer.train.steps=many: must be a whole"]),
        (["stage=tokenizer", "tokenizer.train.steps=0"], ["tokenizer.train.steps=0: must be a whole number from 1"]),
        (["stage=tokenizer", "+tokenizer.model.widht=3"], ["widht", "its arguments are", "width"]),
    ],
)
def test_a_wrong_configuration_is_named_before_there_is_a_run(refused, arguments, words, tmp_path):
    message = refused("train.py", "stage=generator", *arguments)
    for word in words:
        assert word in message, message
    assert not list((tmp_path / "runs").glob("*/*"))


def test_what_does_not_fit_the_machine_or_the_corpus_is_named(refused):
    assert "/nowhere/clip" in refused("train.py", "text=clip_b32", "text.path=/nowhere/clip")
    assert "set scale.protocol.leftover=keep" in refused("evaluate.py", "source=real", "scale.protocol.pool=50000")


def test_wrong_evaluations_are_named(refused, tmp_path):
    assert "source=gen: must be one of generation, nearest" in refused("evaluate.py", "source=gen")
    assert f"{tmp_path}/none holds no weights.safetensors" in refused("evaluate.py", f"run={tmp_path}/none")
    message = refused("evaluate.py", "source=real", "ensure=false")
    assert "train it with `kinema train stage=contrastive data=synthetic" in message
    assert not (tmp_path / "runs" / "contrastive").exists()


@pytest.mark.parametrize("source", ["generation", "reconstruction"])
def test_a_judge_that_reads_more_than_a_method_makes_is_refused(refused, tmp_path, source):
    message = refused("evaluate.py", f"source={source}", "evaluator=redundant")
    assert "error: evaluator=redundant reads redundant dims, method=mardm_sit makes essential ones alone" in message
    assert "choose representation=redundant or evaluator=essential, or lift=true" in message
    assert not (tmp_path / "runs").exists()


def test_a_judge_is_checked_before_another_is_trained(refused, tmp_path):
    message = refused("evaluate.py", "source=real", "+evaluator.contrastive.train.stepz=1")
    assert "error: evaluator.contrastive.train.stepz is no option" in message
    assert not (tmp_path / "runs").exists()


def no_split(corpus: Path) -> None:
    (corpus / "val.txt").unlink()


def no_folder(corpus: Path) -> None:
    shutil.rmtree(corpus)


def no_text_at_all(corpus: Path) -> None:
    shutil.rmtree(corpus / "texts")


def no_motions(corpus: Path) -> None:
    for file in sorted((corpus / "joints").iterdir())[::2]:
        file.unlink()


def wrong_joints(corpus: Path) -> None:
    for file in (corpus / "joints").iterdir():
        np.save(file, np.zeros((60, 17, 3), np.float32))


def other_axis(corpus: Path) -> None:
    for file in (corpus / "joints").iterdir():
        np.save(file, np.load(file)[..., [0, 2, 1]] * np.float32([1, -1, 1]))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (no_split, ["val.txt"]),
        (no_folder, ["corpus", "does not exist"]),
        (no_text_at_all, ["has no captions", "texts/NAME.txt"]),
        (no_motions, ["complete the folder or raise max_missing"]),
        (wrong_joints, ["(60, 17, 3)", "22"]),
        (other_axis, ["clips are unusable", "--up z"]),
    ],
)
def test_a_damaged_corpus_is_named(refused, corpus, damage, words, tmp_path):
    damage(corpus)
    stores = f"paths.stores={tmp_path}/stores"
    message = refused("train.py", *SMALL, f"data.source={corpus}", stores, "stage=generator")
    assert message.startswith("error: ")
    for word in words:
        assert word in message, message
    assert not (tmp_path / "runs" / "tokenizer").exists()
    assert not list((tmp_path / "stores").glob("*-partial"))


def test_unfit_clips_are_left_out_and_told(corpus, overrides, tmp_path, capsys):
    nan, flat = sorted((corpus / "joints").glob("*.npy"))[:2]
    joints = np.load(nan)
    joints[7, 3] = np.nan
    np.save(nan, joints)
    joints = np.load(flat)
    joints[:, 5] = joints[:, 2]
    np.save(flat, joints)
    more = [*SMALL, f"data.source={corpus}", f"paths.stores={tmp_path}/stores", "+data.options.max_missing=0.2"]
    run_stage(compose([*(o for o in overrides if not o.startswith("data")), *more]), "tokenizer")
    said = " ".join(capsys.readouterr().out.split())
    assert "2 clips were left out" in said
    (dropped,) = (tmp_path / "stores").glob("*/dropped.json")
    reasons = {entry["name"]: entry["reason"] for entry in json.loads(dropped.read_text())}
    assert "NaN or infinite values in 1 frames, first 7" in reasons[nan.stem]
    assert "bone" in reasons[flat.stem]
    assert str(dropped) in said


@pytest.fixture(scope="module")
def generator(micro) -> RunFolder:
    return run_stage(compose(micro), "generator")


@pytest.mark.parametrize(
    ("texts", "frames", "words"),
    [
        ([""], [40], "text 0 is empty"),
        (["a person walks", "  "], [40, 40], "text 1 is empty"),
        (["a person walks"], [0], "length 0 is out of range; allowed: 1 to 196"),
        (["a person walks"], [197], "length 197 is out of range; allowed: 1 to 196"),
    ],
)
def test_bad_requests_to_a_trained_run_are_named(generator, texts, frames, words):
    with pytest.raises(ValueError, match=words):
        TextToMotion.from_run(generator.path).generate(texts, frames)


class Code:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def truncate(path: Path, victim: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def poison(path: Path, victim: Path) -> None:
    path.write_bytes(pickle.dumps(Code(victim)))


def poison_zip(path: Path, victim: Path) -> None:
    torch.save({"state_dict": Code(victim)}, path)


@pytest.mark.parametrize("damage", [truncate, poison, poison_zip])
def test_a_damaged_checkpoint_is_named_and_runs_nothing(refused, overrides, damage, tmp_path):
    folder = run_stage(compose(overrides), "tokenizer")
    folder.weights.unlink()
    last = folder.path / "checkpoints" / "last.ckpt"
    torch.save({"state_dict": {"weight": torch.zeros(1000)}}, last)
    damage(last, tmp_path / "victim")
    content = last.read_bytes()
    message = refused("train.py", "stage=tokenizer")
    assert message.startswith((f"error: {last} cannot be read", f"error: {last} holds more than tensors"))
    assert "delete it to train this stage from the start" in message
    assert last.read_bytes() == content
    assert not (tmp_path / "victim").exists()
    assert folder.status["state"] == "failed"
    last.unlink()
    assert run_stage(compose(overrides), "tokenizer").done


@pytest.mark.parametrize("damage", [truncate, poison])
def test_damaged_weights_are_named_and_run_nothing(refused, overrides, damage, tmp_path):
    folder = run_stage(compose(overrides), "tokenizer")
    damage(folder.weights, tmp_path / "victim")
    message = refused("evaluate.py", "source=reconstruction")
    assert message.startswith((f"error: {folder.weights} cannot be read", f"error: {folder.weights} is a"))
    assert not (tmp_path / "victim").exists()


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "last.ckpt"
    files = AtomicCheckpointIO({"a": torch.zeros(2)})
    first = {
        "pytorch-lightning_version": "2.6",
        **dict.fromkeys(("epoch", "global_step"), 1),
        **{name: {} for name in ("loops", "callbacks")},
        **{name: [] for name in ("optimizer_states", "lr_schedulers")},
        "state_dict": {"a": torch.zeros(2)},
    }
    files.save_checkpoint(first, path)

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(
            OSError, match=r"could not write checkpoint .*No space left.*previous checkpoint is untouched"
        ):
            files.save_checkpoint({"step": 2}, path)
        with pytest.raises(OSError, match="free disk space"):
            weights.save(torch.nn.Linear(1, 1), {"_target_": "kinema.x"}, tmp_path / "weights.safetensors")
    assert files.load_checkpoint(path)["global_step"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["last.ckpt"]


def test_a_full_disk_during_training_fails_the_run_which_resumes(refused, overrides, monkeypatch):
    real, calls = torch.save, []

    def save(*arguments, **options):
        calls.append(1)
        if len(calls) == 3:
            raise RuntimeError("PytorchStreamWriter failed writing file data/0: file write failed")
        return real(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(torch, "save", save)
        message = refused("train.py", "stage=tokenizer")
    assert "could not write checkpoint" in message
    assert "run the same command again: it resumes" in message
    cfg = compose(overrides)
    (folder,) = [RunFolder(p) for p in Path(cfg.paths.runs, "tokenizer").iterdir()]
    assert folder.status["state"] == "failed"
    assert [p.name for p in (folder.path / "checkpoints").iterdir()] == ["last.ckpt"]
    assert run_stage(cfg, "tokenizer").status["step"] == 24
