"""`representation=` toggles the columns from the store to the weights: every stage is served those that it reads."""

from __future__ import annotations

import shutil

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import load_file

from kinema.data.datamodule import MotionDataModule
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.run import run_stage
from kinema.experiments.scoring import Scorer
from kinema.experiments.stages import get_stage, needs_of, stages
from kinema.experiments.stages.fitted import FittedStage
from kinema.motion.skeleton import DIMS
from kinema.runs import weights
from kinema.training.modules import StageModule

WIDTHS = {"essential": 67, "redundant": 263}
METHOD_WITH = {"shortcut": "latent_flow_few"}
"""Methods of stages that momask has not."""


def brief(overrides: list[str], dims: str, *more: str, method: str = "momask") -> list[str]:
    """Give the overrides of a method (by default one with nearly every stage), two steps each, on these dims."""
    chosen = [*(o for o in overrides if not o.startswith("generator.model")), f"method={method}", *more]
    chosen += [f"representation={dims}", f"evaluator.representation={dims}"]
    for stage in stages().values():
        if OmegaConf.select(compose(chosen), f"{stage.node}.train") is not None:
            chosen += [f"{stage.node}.train.{key}=2" for key in ("steps", "validate_every")]
    return chosen


@pytest.fixture
def served(monkeypatch) -> list[int]:
    """Collect the widths of the batches that models are trained on."""
    widths: list[int] = []
    step = StageModule.training_step

    def watched(self, batch, index):
        widths.append(batch.features.shape[-1])
        return step(self, batch, index)

    monkeypatch.setattr(StageModule, "training_step", watched)
    return widths


@pytest.mark.parametrize("dims", DIMS)
@pytest.mark.parametrize("name", [name for name, stage in stages().items() if isinstance(stage, FittedStage)])
def test_a_stage_is_served_what_it_reads_and_learns_what_it_would_from_all(name, dims, overrides, served, monkeypatch):
    cfg = compose(brief(overrides, dims, method=METHOD_WITH.get(name, "momask")))
    stage = get_stage(name)
    for needed in needs_of(stage):
        if needed.present(cfg):
            run_stage(cfg, needed.name)
    run = run_stage(cfg, name)
    # Companions are made on the way: the stage's own two steps come last.
    assert served[-2:] == [WIDTHS[stage.dims(cfg)]] * 2
    module, meta = weights.load(run.weights)
    if "representation" in meta:
        assert meta["representation"]["kind"] == dims
    elif name != "length":  # which reads no column
        assert module.representation.width == WIDTHS[dims]
    if stage.dims(cfg) == "essential":
        learnt = load_file(run.weights)
        shutil.rmtree(run.path)
        monkeypatch.setattr(type(stage), "dims", lambda self, cfg: "redundant")
        whole = load_file(run_stage(cfg, name).weights)
        assert served[-2:] == [WIDTHS["redundant"]] * 2
        assert learnt.keys() == whole.keys()
        assert all(torch.equal(value, whole[key]) for key, value in learnt.items())


@pytest.mark.parametrize(
    ("choices", "dims"),
    [
        (["source=real"], "essential"),
        (["source=real", "evaluator=redundant"], "redundant"),
        (["source=generation", "representation=redundant"], "essential"),  # the generator reads captions alone
        (["source=reconstruction"], "essential"),
        (["source=reconstruction", "representation=redundant"], "redundant"),
        (["source=generation", "representation=redundant", "task=editing"], "redundant"),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(o.split("=")[1] for o in value),
)
def test_a_row_is_scored_on_what_its_judges_and_its_source_read(choices, dims, micro, monkeypatch):
    cfg = compose([*micro, "scale.protocol.replications=1", *choices], "evaluate")
    row = run_evaluation(cfg)
    store = open_corpus(cfg)
    scorer = Scorer(cfg, row, store)
    assert scorer.data.dims == dims
    scorer.data = MotionDataModule(store, kind="clips", batch_size=1, steps=1)
    assert scorer.replicate(0).metrics == row.lines[0]["metrics"]
