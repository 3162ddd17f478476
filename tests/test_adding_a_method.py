"""The examples of docs/adding_a_method.md work: they train, generate, edit and are scored, and touch no other file."""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinema.experiments.config import compose
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.identity import fingerprint, stage_identity
from kinema.experiments.run import run_stage
from kinema.experiments.stages import get_stage
from kinema.generators import Generator
from kinema.pipeline import TextToMotion
from kinema.runs.console import console
from kinema.runs.folder import RunFolder

PAGE = Path(__file__).resolve().parent.parent / "docs" / "adding_a_method.md"
BLOCK = re.compile(r"`((?:src|conf)/[\w/]+\.(?:py|yaml))`:\n\n```\w+\n(.*?)```", re.DOTALL)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Iterator[Path]:
    """Put the page's files where they would be, once: beside the package's modules, and on Hydra's path."""
    root, modules = tmp_path_factory.mktemp("page"), []
    with pytest.MonkeyPatch.context() as patch:
        for name, text in BLOCK.findall(PAGE.read_text()):
            file = root / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
            if file.suffix == ".py":
                *parents, module = Path(name).with_suffix("").parts[1:]
                package = importlib.import_module(".".join(parents))
                if str(file.parent) not in package.__path__:
                    patch.setattr(package, "__path__", [*package.__path__, str(file.parent)])
                modules.append(f"{package.__name__}.{module}")
        yield root
    for module in modules:
        sys.modules.pop(module, None)


@pytest.fixture
def page(files, overrides) -> list[str]:
    """Give the overrides of a micro run of the page's methods."""
    own = [o for o in overrides if not o.startswith(("generator.", "length."))]
    return [*own, f"hydra.searchpath=[file://{files}/conf]", "generator.train.steps=8", "length.train.steps=4"]


def rows(overrides: list[str]) -> None:
    """Score the method's generation and an edit."""
    for more in ([], ["task=editing", "edit.task=prefix"]):
        row = run_evaluation(compose([*overrides, *more], "evaluate"))
        assert len(row.lines) == row.replications


def test_a_method_of_tokens_trains_generates_and_edits(page):
    own = [*page, "method=independent"]
    run = run_stage(compose(own), "generator")
    model = TextToMotion.from_run(run.path, device="cpu")
    assert isinstance(model.generator, Generator)
    motions = model.generate(["a person walks", "a man jumps"], [40, 60], seed=1)
    (alone,) = model.generate("a man jumps", 60, seed=motions[1].seed)
    np.testing.assert_allclose(alone.features, motions[1].features, rtol=1e-3, atol=1e-3)
    (edited,) = model.edit(motions[0], "someone waves", "suffix", seed=2)
    assert np.array_equal(edited.features[20:], motions[0].features[20:])
    rows(own)


def test_a_method_on_frames_trains_generates_and_edits_to_the_frame(page, tmp_path):
    own = [o for o in page if not o.startswith("tokenizer.train")] + ["method=regression"]
    run = run_stage(compose(own), "generator")
    model = TextToMotion.from_run(run.path, device="cpu")
    assert not any(True for _ in model.tokenizer.parameters())
    motions = model.generate(["a person walks", "a man jumps"], [41, 60], seed=1)
    (alone,) = model.generate("a man jumps", 60, seed=motions[1].seed)
    np.testing.assert_allclose(alone.features, motions[1].features, rtol=1e-3, atol=1e-3)
    (edited,) = model.edit(motions[0], "someone waves", [(7, 22)], seed=2)
    assert np.array_equal(edited.features[22:], motions[0].features[22:])
    assert (edited.features[7:22] != motions[0].features[7:22]).any(axis=1).all()
    model.save(tmp_path / "portable")
    again = TextToMotion.from_run(tmp_path / "portable", device="cpu")
    assert np.array_equal(again.generate("a man jumps", 60, seed=3)[0].features,
                          model.generate("a man jumps", 60, seed=3)[0].features)  # fmt: skip
    rows(own)


def test_a_stage_that_builds_something_is_made_once_found_again_and_attached(page, tmp_path):
    own = [*page, "method=informed"]
    run = run_stage(compose(own), "generator")
    links = json.loads((run.path / "upstream.json").read_text())
    assert set(links) == {"tokenizer", "prior", "length"}
    prior = RunFolder((run.path / links["prior"]).resolve())
    assert (prior.status["state"], prior.status["step"]) == ("done", None)
    assert set(json.loads((prior.path / "upstream.json").read_text())) == {"tokenizer"}
    with console.capture() as said:
        assert run_stage(compose([*own, "generator.train.lr=1e-5"]), "prior").path == prior.path
    assert said.get() == f"cached    {prior.path}\n"

    model = TextToMotion.from_run(run.path, device="cpu")
    assert model.parts["prior"].log_shares.exp().sum() == pytest.approx(1, abs=1e-5)
    assert not any("prior" in name for name in model.generator.state_dict())
    motions = model.generate(["a person walks", "a man jumps"], [40, 60], seed=1)
    again = TextToMotion.from_run(model.save(tmp_path / "portable"), device="cpu")
    for ours, theirs in zip(motions, again.generate(["a person walks", "a man jumps"], [40, 60], seed=1), strict=True):
        assert np.array_equal(ours.features, theirs.features)
    rows(own)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("generator.sampling.temperature=0", r"generator\.sampling\.temperature=0: must be a finite number > 0"),
        ("generator.sampling.temperature=hot", r"generator\.sampling\.temperature=hot: must be"),
        ("generator.model.width=0", r"generator\.model\.width=0: must be a whole number"),
    ],
)
def test_a_wrong_option_of_the_pages_method_is_one_line(page, change, told):
    with pytest.raises(ValueError, match=f"^{told}"):
        run_stage(compose([*page, "method=independent", change]), "generator")


def test_a_built_stage_is_part_of_the_fingerprints_of_those_who_read_it(page):
    def names(*more: str) -> list[str]:
        cfg = compose([*page, "method=informed", *more])
        return [
            fingerprint(stage_identity(cfg, get_stage(name), lambda _: "corpus")) for name in ("prior", "generator")
        ]

    prior, generator = names()
    assert names("generator.train.lr=1e-5")[0] == prior
    for change in ("tokenizer.train.steps=3", "+prior.model.smoothing=2", "seed=1"):
        changed = names(change)
        assert changed[0] != prior
        assert changed[1] != generator
    without = stage_identity(compose([*page, "method=independent"]), get_stage("generator"), lambda _: "corpus")
    assert set(without["upstream"]) == {"tokenizer"}
