"""A module put beside the sources of motion is one: its rows are named, told apart, scored and refused as it says."""

from __future__ import annotations

import sys

import pytest

from kinema.experiments import sources as package
from kinema.experiments.config import compose, validate
from kinema.experiments.evaluation import describe, run_evaluation
from kinema.experiments.sources import source_of, sources
from kinema.experiments.stages import get_stage

STANDING = """
import torch

from kinema.evaluation.source import Source, answer
from kinema.experiments.sources.base import ScoredSource


class Still(Source):
    label = "standing still"

    def __call__(self, batch, seeds):
        return answer(batch, batch.features[:, :1].expand_as(batch.features) * batch.mask[..., None], batch.lengths)


class StandingSource(ScoredSource):
    name = "standing"
    groups = ("perturb",)

    def check(self, cfg, store):
        if cfg.perturb.level > 1:
            raise ValueError("it stands")

    def label(self, cfg):
        return "standing_still"

    def open(self, scorer, row):
        return Still()

    def completed(self, metrics):
        return {"stillness": 1.0}
"""


@pytest.fixture
def standing(tmp_path, monkeypatch):
    """Put a source beside ours for one test."""
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "standing.py").write_text(STANDING)
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    yield
    sys.modules.pop(f"{package.__name__}.standing", None)


def test_a_module_beside_ours_is_a_source_without_another_edit(standing, micro):
    asked = [*micro, "source=standing", "scale.protocol.replications=1"]
    row = run_evaluation(compose(asked, "evaluate"))
    assert row.folder.path.name.startswith("standing_still-synthetic")
    assert row.subject == {}
    metrics = row.lines[0]["metrics"]
    assert metrics["jitter"] < 0.1 * metrics["real_jitter"]
    assert metrics["stillness"] == 1
    told = row.lines[0]["provenance"]
    assert told["perturb"]["how"] == "add"
    assert told["edit"] is told["control"] is told["oracle"] is told["sampling"] is None
    other = describe(compose([*asked, "perturb.level=0.25"], "evaluate"))
    assert other.digest != row.digest
    with pytest.raises(ValueError, match="it stands"):
        run_evaluation(compose([*asked, "perturb.level=2"], "evaluate"))


@pytest.mark.parametrize("option", ["task=editing", "precision=bfloat16"])
def test_what_is_a_generators_alone_is_refused_of_the_others(option):
    for name in set(sources()) - {"generation"}:
        with pytest.raises(ValueError, match=f"source={name}"):
            validate(compose([f"source={name}", option], "evaluate"))
    validate(compose(["source=generation", option], "evaluate"))


def test_a_source_that_is_none_is_named_with_those_there_are():
    with pytest.raises(ValueError, match="source=motion: must be one of generation, nearest, noise, oracle"):
        validate(compose(["source=motion"], "evaluate"))


def test_what_a_source_scores_is_a_stage_and_its_groups_are_of_the_configuration():
    for name, source in sources().items():
        cfg = compose([f"source={name}"], "evaluate")
        assert source_of(cfg) is source
        assert source.scores is None or get_stage(source.scores).present(cfg)
        assert set(source.groups) <= set(cfg)
        assert set(source.read_groups(cfg)) <= set(source.groups)
