"""Motion that was generated once is given again, and never to another question."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.evaluation.toys import Evaluated, model, seeds

from kinema.evaluation.remembered import Remembered
from kinema.evaluation.sources import Generated


def test_what_was_generated_once_is_given_again_with_what_was_measured_then(make, tmp_path):
    batch, other = make.batch(), make.batch(size=4, seed=1)
    alone = Generated(model(Evaluated()))
    wanted = [alone(batch, seeds(8)), alone(other, seeds(4))]
    first = Remembered(Generated(model(Evaluated())), tmp_path)
    made = [first(batch, seeds(8)), first(other, seeds(4))]
    assert first.measured() == alone.measured()
    took = first.seconds()
    generator = Evaluated()
    generator.sample = None  # any work would fail
    again = Remembered(Generated(model(generator)), tmp_path)
    given = [again(replace(batch, features=batch.features[..., :67]), seeds(8)), again(other, seeds(4))]
    assert again.measured() == {"denoiser_calls": 3, "denoiser_rows": 6}
    assert again.seconds() == took > 0
    for before, kept, later in zip(wanted, made, given, strict=True):
        assert torch.equal(before.features, kept.features)
        assert torch.equal(before.features, later.features)
        assert torch.equal(before.lengths, later.lengths)
    assert again.measured() == {}
    assert again.seconds() is None


@pytest.mark.parametrize(
    "asked",
    [
        lambda batch: (batch, seeds(8) + 1),
        lambda batch: (replace(batch, lengths=batch.lengths - 4), seeds(8)),
        lambda batch: (replace(batch, captions=batch.captions[::-1]), seeds(8)),
        lambda batch: (replace(batch, clip_ids=batch.clip_ids[::-1]), seeds(8)),
    ],
)
def test_another_question_is_never_given_the_same_motion(make, tmp_path, asked):
    source, batch = Remembered(Generated(model(), sampling=2.0), tmp_path), make.batch()
    source(batch, seeds(8))
    question = asked(batch)
    found, wanted = source(*question), Generated(model(), sampling=2.0)(*question)
    assert torch.equal(found.features, wanted.features)
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_kept_motion_that_is_damaged_is_generated_anew(make, tmp_path, capsys):
    ask = (make.batch(), seeds(8))
    wanted = Remembered(Generated(model(), sampling=2.0), tmp_path)(*ask)
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:-40])
    assert torch.equal(Remembered(Generated(model(), sampling=2.0), tmp_path)(*ask).features, wanted.features)
    assert file.name in capsys.readouterr().out.replace("\n", "")
