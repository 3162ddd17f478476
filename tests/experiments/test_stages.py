"""A stage is one file: its name stands nowhere else, what it needs comes first, what a method lacks is left out."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kinema.experiments import stages as package
from kinema.experiments import training
from kinema.experiments.config import compose
from kinema.experiments.evaluation import describe
from kinema.experiments.identity import stage_identity
from kinema.experiments.run import run_stage
from kinema.experiments.stages import companions_of, get_stage, needs_of, stages
from kinema.experiments.stages.base import Summary
from kinema.runs.parts import upstream
from kinema.runs.weights import load

SOURCE = Path(__file__).resolve().parents[2] / "src"
ALLOWED = {
    "kinema.experiments.stages": set(stages()),
    "kinema.runs.parts": set(stages()),
    "kinema.generators": {"residual", "retrieval", "generator", "shortcut"},
    "kinema.evaluation.metrics.retrieval": {"matching"},
    "kinema.experiments.evaluation": {"matching"},
    "kinema.experiments.breakdowns": {"matching"},
    "kinema.experiments.watching": {"matching"},
    "kinema.motion.captures.asf": {"length"},
    "kinema.motion.formats.glb": {"generator"},
}


def test_stage_names_are_written_in_the_stages_alone():
    """Hold the string literals of src to this rule: a stage's name is written by the stages (and in conf).

    What a run holds is called as the stage that makes it. Rooms that may not import experiments take that name from
    runs/parts.py, and a generator names the parts that it takes (beside torch's argument `generator`). A metric is
    called matching too, a bone of ASF has a length, a glTF file names its generator.
    """
    names, strays = set(stages()), []
    for file in sorted(SOURCE.rglob("*.py")):
        module = ".".join(file.relative_to(SOURCE).with_suffix("").parts)
        allowed = set().union(*(found for room, found in ALLOWED.items() if f"{module}.".startswith(f"{room}.")))
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in names - allowed:
                strays.append(f"{module}:{node.lineno} {node.value}")
    assert not strays


def test_what_is_read_comes_first():
    place = {name: i for i, name in enumerate(stages())}
    for stage in stages().values():
        for other in (*needs_of(stage), *companions_of(stage)):
            assert place[other.name] < place[stage.name]
    assert [other.name for other in needs_of(get_stage("generator"))] == ["tokenizer", "retrieval"]
    assert [other.name for other in companions_of(get_stage("generator"))] == ["length", "residual"]


def test_an_unknown_stage_is_named_with_those_there_are():
    with pytest.raises(ValueError, match=r"stage='decoder' is unknown; allowed: contrastive, .*tokenizer"):
        get_stage("decoder")


def test_a_stage_that_the_method_lacks_is_no_part_of_it(overrides):
    cfg = compose([*overrides, "method=mardm_sit", "tokenizer.model=null", "generator.model.latent_dim=8"])
    absent = {name for name, stage in stages().items() if not stage.present(cfg)}
    assert absent == {"tokenizer", "residual", "retrieval", "shortcut"}
    assert stage_identity(cfg, get_stage("generator"), lambda _: "corpus")["upstream"] == {}
    for name in absent:
        with pytest.raises(ValueError, match=f"method mardm_sit has no stage {name}"):
            run_stage(cfg, name)


def test_a_model_without_a_recipe_is_built_and_takes_the_corpus_statistics(overrides):
    """A method on frames has such a tokenizer: the representation alone."""
    kept = [o for o in overrides if not o.startswith("tokenizer.")]
    cfg = compose([*kept, "tokenizer.train=null", "tokenizer.name=frames", "generator.model.latent_dim=8"])
    cfg.tokenizer.model = {
        "_target_": "kinema.tokenizers.frames.Frames",
        "representation": cfg.tokenizer.model.representation,
    }
    run = run_stage(cfg, "tokenizer")
    assert run.status["state"] == "done"
    assert run.status["step"] is None
    assert not (run.path / "metrics.jsonl").exists()
    module, meta = load(run.weights)
    assert meta["part"] == "tokenizer"
    assert module.representation.fitted


@pytest.fixture
def add_stage(tmp_path, monkeypatch) -> Iterator[Callable[[str, str], None]]:
    """Put a file beside the stages for one test."""
    folder = tmp_path / "stages"
    folder.mkdir()
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    yield lambda name, code: (folder / f"{name}.py").write_text(code)
    for file in folder.glob("*.py"):
        sys.modules.pop(f"{package.__name__}.{file.stem}", None)


NOTE = """
from kinema.experiments.stages.base import Stage, Summary

class NoteStage(Stage):
    name, node = "note", "note"
    companion_of = ("generator",)

    def make(self, cfg, store, needs, folder):
        if cfg.note.get("broken"):
            raise OSError("out of ink")
        folder.weights.write_text(cfg.note.text)
        return Summary(0.0)
"""


def test_a_companion_is_made_and_linked_without_influence(add_stage, overrides, monkeypatch):
    monkeypatch.setattr(training, "make_model", lambda stage, cfg, store, needs, folder: written(folder))
    add_stage("note", NOTE)
    assert "note" not in upstream(run_stage(compose(overrides), "generator").path)
    with pytest.raises(OSError, match="out of ink"):
        run_stage(compose([*overrides, "+note={text: a, broken: true}"]), "note")
    cfg = compose([*overrides, "+note.text=a", "generator.train.lr=1e-5"])
    run = run_stage(cfg, "generator")
    assert set(upstream(run.path)) == {"tokenizer", "length", "note"}
    assert (upstream(run.path)["note"] / "weights.safetensors").read_text() == "a"

    given = [*overrides, "generator.train.lr=1e-5"]
    assert run_stage(compose([*given, "+note.text=b"]), "generator").path == run.path
    rows = {text: describe(compose([*given, f"+note.text={text}"], "evaluate")) for text in "ab"}
    assert rows["a"].beside["note"] == upstream(run.path)["note"]
    assert rows["a"].folder.path != rows["b"].folder.path


def written(folder) -> Summary:
    folder.weights.write_bytes(b"weights")
    return Summary(1.0)


SECOND = """
from kinema.experiments.stages.fitted import FittedStage

class SecondStage(FittedStage):
    name, node = "second", "second"
    needs = ("tokenizer",)
"""


def test_a_fitted_stage_is_a_name_and_a_node(add_stage, overrides):
    add_stage("second", SECOND)
    cfg = compose([*overrides, "+second={model: ${tokenizer.model}, train: ${tokenizer.train}}"])
    run = run_stage(cfg, "second")
    assert run.status["step"] == 24
    module, meta = load(run.weights)
    assert (meta["part"], module.representation.kind) == ("second", "essential")
    assert list(upstream(run.path)) == ["tokenizer"]
    assert run_stage(cfg, "second").path == run.path


def test_two_stages_of_one_name_and_strangers_are_named(add_stage):
    add_stage("note", NOTE)
    add_stage("other", NOTE.replace("NoteStage", "OtherStage"))
    with pytest.raises(ValueError, match=r"OtherStage'> and .*NoteStage'> are both stage 'note'"):
        stages()
    add_stage("other", NOTE.replace('"note", "note"', '"other", "other"').replace('"generator"', '"decoder"'))
    sys.modules.pop(f"{package.__name__}.other")
    with pytest.raises(ValueError, match=r"a stage names 'decoder', which is none; stages: .*contrastive"):
        stages()
