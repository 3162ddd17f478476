"""The worked example of docs/adding_a_method.md is a method: it trains, generates, edits, and fits the contract."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from kinema.experiments.config import compose
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.run import run_stage
from kinema.generators import Generator
from kinema.pipeline import TextToMotion

PAGE = Path(__file__).resolve().parent.parent / "docs" / "adding_a_method.md"


@pytest.fixture
def example(tmp_path, monkeypatch) -> list[str]:
    """Put the page's two files where they would be, and give the overrides that find them."""
    blocks = dict(re.findall(r"`((?:src|conf)/[\w/]+\.(?:py|yaml))`:\n\n```\w+\n(.*?)```", PAGE.read_text(), re.S))
    (source, code), (config, text) = sorted(blocks.items(), reverse=True)
    name = ".".join(Path(source).with_suffix("").parts[1:])
    module = types.ModuleType(name)
    monkeypatch.setitem(sys.modules, name, module)
    exec(compile(code, source, "exec"), module.__dict__)
    file = tmp_path / Path(config).relative_to("conf")
    file.parent.mkdir()
    file.write_text(text)
    return [f"hydra.searchpath=[file://{tmp_path}]", "method=independent"]


def test_the_example_trains_generates_and_edits(example, overrides):
    own = [o for o in overrides if not o.startswith(("generator.", "length."))]
    own += [*example, "generator.train.steps=8", "length.train.steps=4"]
    run = run_stage(compose(own), "generator")
    model = TextToMotion.from_run(run.path, device="cpu")
    assert isinstance(model.generator, Generator)
    motions = model.generate(["a person walks", "a man jumps"], [40, 60], seed=1)
    (alone,) = model.generate("a man jumps", 60, seed=motions[1].seed)
    np.testing.assert_allclose(alone.features, motions[1].features, rtol=1e-3, atol=1e-3)
    (edited,) = model.edit(motions[0], "someone waves", "suffix", seed=2)
    assert np.array_equal(edited.features[20:], motions[0].features[20:])
    for more in ([], ["task=editing", "edit.task=prefix"]):
        row = run_evaluation(
            compose([*own, *example, "generator.train.steps=8", "length.train.steps=4", *more], "evaluate")
        )
        assert len(row.lines) == row.replications
