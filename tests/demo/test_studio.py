"""What the page asks of a model: within limits, numbered, kept to the bit outside an edit, written in every format."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from tests.contracts.test_toys import Summary, Toy

from kinema.cli import main
from kinema.demo.studio import COUNT, LETTERS, SHOWN, Studio, read_seed
from kinema.motion.body_parts import columns_of
from kinema.motion.export import FORMATS
from kinema.pipeline import TextToMotion
from kinema.tokenizers.frames import Frames
from kinema.types import Motion


@pytest.fixture
def studio(model) -> Studio:
    return Studio(model)


@pytest.fixture
def takes(studio):
    return studio.generate([], "a person walks", 2.0, 2, 5)


def on(tokenizer, model) -> Studio:
    """Give a studio of a toy method on other latents."""
    return Studio(TextToMotion(tokenizer.eval(), Toy(tokenizer.space).eval(), model.text_encoder))


def test_motions_are_what_the_model_gives_for_text_length_and_seed(studio, takes):
    alone = studio.model.generate(["a person walks"] * 2, seconds=2.0, seed=5)
    assert [take.number for take in takes] == [1, 2]
    assert all(np.array_equal(take.motion.joints, one.joints) for take, one in zip(takes, alone, strict=True))
    assert len(takes[0].motion.joints) == 40
    estimated = studio.generate(takes, "a person walks", None, 1, 5)[-1]
    assert np.array_equal(estimated.motion.joints, studio.model.generate("a person walks", seed=5)[0].joints)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (("", 2.0, 1, 0), "text 0 is empty"),
        (("walk" * LETTERS, 2.0, 1, 0), f"the text has {4 * LETTERS} letters; at most {LETTERS} are read here"),
        (("walk", 2.0, COUNT + 1, 0), f"count={COUNT + 1}: must be a whole number from 1 to {COUNT}"),
        (("walk", 2.0, 0, 0), "count=0"),
        (("walk", 1e308, 1, 0), r"seconds=1e\+308: must be a finite number > 0 and <= 9.8"),
        (("walk", 0.0, 1, 0), "seconds=0"),
        (("walk", float("nan"), 1, 0), "seconds=NaN"),
        (("walk", 2.0, 1, -1), "seed=-1"),
    ],
)
def test_requests_beyond_the_limits_are_refused_in_one_line(studio, asked, message):
    with pytest.raises(ValueError, match=message) as refused:
        studio.generate([], *asked)
    assert "\n" not in str(refused.value)


def test_a_seed_is_a_number_or_drawn():
    assert (read_seed(" "), read_seed("0"), read_seed(" 12 ")) == (None, 0, 12)
    with pytest.raises(ValueError, match="seed 'twelve' is no whole number; leave it empty to draw one"):
        read_seed("twelve")


def test_a_range_is_regenerated_and_the_rest_stays_to_the_bit(studio, takes):
    *before, edited = studio.regenerate(takes, 1, "a person jumps", (12, 28), None, 3)
    source = takes[0].motion
    assert before == takes
    assert edited.label == "3 (1 with 0.6 to 1.4 s new)"
    kept = np.r_[0:12, 28:40]
    assert np.array_equal(edited.motion.features[kept], source.features[kept])
    assert (edited.motion.features[12:28] != source.features[12:28]).any(axis=1).all()
    assert np.array_equal(edited.motion.joints[:12], source.joints[:12])
    assert not edited.motion.kept[12:28].any()


@pytest.mark.parametrize(
    ("number", "frames", "message"),
    [(1, (30, 10), "range"), (1, (0, 41), "range"), (9, (0, 10), "there is no such motion any more")],
)
def test_what_is_no_range_of_a_motion_is_refused(studio, takes, number, frames, message):
    with pytest.raises(ValueError, match=message):
        studio.regenerate(takes, number, "a person jumps", frames, None, 0)


def test_a_part_of_the_body_where_the_method_can(studio, takes, model):
    assert not studio.edits_parts
    with pytest.raises(ValueError, match="regenerating a part of the body"):
        studio.regenerate(takes, 1, "a person waves", (0, 40), "upper", 0)
    frames = on(Frames(model.tokenizer.representation), model)
    assert frames.edits_parts
    (source,) = frames.generate([], "a person walks", 2.0, 1, 1)
    edited = frames.regenerate([source], 1, "a person waves", (10, 30), "upper", 2)[-1]
    assert edited.label == "2 (1 with upper body, 0.5 to 1.5 s new)"
    lower = columns_of("lower", frames.model.skeleton)[: source.motion.features.shape[1]]
    assert np.array_equal(edited.motion.features[:, lower], source.motion.features[:, lower])
    assert (edited.motion.features[10:30, ~lower] != source.motion.features[10:30, ~lower]).any()


def test_a_method_whose_latents_are_no_stretches_of_time_says_so(studio, model):
    assert studio.edits
    assert not on(Summary(model.tokenizer.representation), model).edits


def test_the_oldest_motions_go_and_numbers_stay(studio, takes):
    for _ in range(SHOWN // 2):
        takes = studio.generate(takes, "a person walks", 1.0, 2, 0)
    assert [take.number for take in takes] == list(range(3, 3 + SHOWN))
    with pytest.raises(ValueError, match="no such motion"):
        studio.find(takes, 1)


@pytest.mark.parametrize("suffix", FORMATS)
def test_files_are_named_by_what_happens_in_them_and_leave_nothing(studio, takes, suffix, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    try:
        name, content = studio.write(takes, 2, suffix)
    except (ImportError, ValueError) as error:
        if "pip install 'kinema[" not in str(error):  # what an extra is for
            raise
        pytest.skip(str(error))
    assert name == f"a-person-walks-2{suffix}"
    assert len(content) > 1000
    assert not list(tmp_path.iterdir())
    if suffix == ".npy":
        assert np.array_equal(np.load(io.BytesIO(content)), takes[1].motion.joints)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("../../etc/passwd", "etc-passwd-1.npy"),
        ("走る", "motion-1.npy"),
        ("<b>" + "very " * 50, "b-very-very-very-very-very-very-very-ver-1.npy"),
    ],
)
def test_a_text_is_no_path(studio, text, name):
    (take,) = studio.generate([], text, 1.0, 1, 0)
    assert isinstance(take.motion, Motion)
    assert studio.write([take], 1, ".npy")[0] == name


def test_without_gradio_the_command_says_how_to_get_it(run, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "gradio", None)
    assert main(["demo", "--run", str(run), "--device", "cpu"]) == 2
    assert capsys.readouterr().err == "error: the demo needs gradio: pip install 'kinema[demo]'\n"


@pytest.mark.parametrize("port", ["0", "70000"])
def test_a_port_is_one(run, capsys, port):
    assert main(["demo", "--run", str(run), "--port", port]) == 2
    assert capsys.readouterr().err == f"error: --port={port}: must be a whole number from 1 to 65535\n"
