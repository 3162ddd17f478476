"""Dashboards hold what metrics.jsonl holds, at its steps, also after a resume; looking changes nothing of a run."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from lightning import Trainer
from safetensors.torch import load_file

from kinema.experiments.config import compose
from kinema.experiments.dashboards import show_page, show_table
from kinema.experiments.evaluation import run_evaluation
from kinema.experiments.previews import films_here
from kinema.experiments.run import run_stage, stage_folder
from kinema.experiments.stages import get_stage
from kinema.runs.lines import read_lines
from kinema.training import fit as fitting
from kinema.training.dashboards import About, dashboards, kinds
from kinema.training.observers import Observer

SHORT = [
    "trainer.log_every=2",
    "logger.names=[csv,tensorboard,wandb]",
    "callbacks.samples_every=5",
    "callbacks.sample_prompts=2",
    *(f"{node}.train.{key}" for node in ("tokenizer", "generator") for key in ("steps=12", "validate_every=4")),
]


@pytest.fixture(autouse=True)
def quiet(monkeypatch):
    monkeypatch.setenv("WANDB_SILENT", "true")
    pytest.importorskip("wandb", reason="reads wandb's offline files")
    pytest.importorskip("tensorboard", reason="reads TensorBoard's event files")


def wandb_records(folder: Path) -> list:
    """Read the one offline run of a folder; wandb's own process writes the end of it after `finish` has returned."""
    (path,) = folder.glob("logs/wandb/offline-run-*/run-*.wandb")
    for _ in range(600):
        records = list(parse(path.read_bytes()))
        if any(record.WhichOneof("record_type") == "exit" for record in records):
            return records
        time.sleep(0.1)
    raise TimeoutError(f"{path} has no end")


def parse(data: bytes) -> Iterator:
    """Read wandb's records: LevelDB's log format behind a header of seven bytes."""
    from wandb.proto import wandb_internal_pb2

    at, part = 7, b""
    assert data.startswith(b":W&B")
    while at + 7 <= len(data):
        if (left := 32768 - at % 32768) < 7:
            at += left
            continue
        size, kind = int.from_bytes(data[at + 4 : at + 6], "little"), data[at + 6]
        part, at = part + data[at + 7 : at + 7 + size], at + 7 + size
        if at > len(data):
            return
        if kind in (1, 4):  # whole, or the last part
            record = wandb_internal_pb2.Record()
            record.ParseFromString(part)
            part = b""
            yield record


def wandb_rows(folder: Path) -> dict[int, dict]:
    rows: dict[int, dict] = {}
    for record in wandb_records(folder):
        if record.WhichOneof("record_type") == "history":
            step = record.history.step.num
            assert step not in rows
            rows[step] = {i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in record.history.item}
    return rows


def events(folder: Path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (path,) = folder.glob("logs/tensorboard/events.out.tfevents.*")
    read = EventAccumulator(str(path))
    read.Reload()
    return read


def metrics(folder: Path) -> dict[str, dict[int, float]]:
    """Read metrics.jsonl: the value of every number by its step, each once."""
    found: dict[str, dict[int, float]] = {}
    for line in read_lines(folder / "metrics.jsonl"):
        for key in line.keys() - {"step", "seconds"}:
            assert line["step"] not in found.setdefault(key, {}), (key, line["step"])
            found[key][line["step"]] = line[key]
    return found


def check_all_dashboards(folder: Path) -> dict[str, dict[int, float]]:
    """Compare csv, TensorBoard and wandb with metrics.jsonl; returns that."""
    kept, rows, board = metrics(folder), wandb_rows(folder), events(folder)
    with (folder / "logs/csv/metrics.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert set(board.Tags()["scalars"]) == kept.keys()
    for key, values in kept.items():
        assert {event.step: event.value for event in board.Scalars(key)} == pytest.approx(values)
        assert len(board.Scalars(key)) == len(values)
        assert {step: row[key] for step, row in rows.items() if key in row} == pytest.approx(values)
        found = [(int(line["step"]), float(line[key])) for line in lines if line[key]]
        assert dict(found) == pytest.approx(values)
        assert len(found) == len(values)
    return kept


def test_a_generators_numbers_and_samples_stand_at_their_steps_everywhere(overrides):
    run = run_stage(compose([*overrides, *SHORT]), "generator").path
    kept = check_all_dashboards(run)
    assert list(kept["train/loss"]) == [2, 4, 6, 8, 10, 12]
    assert list(kept["val/loss"]) == [4, 8, 12]
    for key in ("optim/lr", "optim/grad_norm", "pace/steps_per_second", "pace/data_wait"):
        assert list(kept[key]) == list(kept["train/loss"]), key
    assert all(0 <= share <= 1 for share in kept["pace/data_wait"].values())
    # Every five steps and at the last, none of which but the last is validated.
    assert sorted(p.name for p in (run / "samples").glob("*.html")) == [f"step-{s:07d}.html" for s in (5, 10, 12)]
    assert [step for step, row in wandb_rows(run).items() if "samples/path" in row] == [5, 10, 12]
    assert [event.step for event in events(run).Tensors("samples/text_summary")] == [5, 10, 12]


def test_the_learning_rate_is_the_steps_own(overrides):
    own = ["generator.train.warmup=4", "generator.train.decay=milestones", "trainer.log_every=1"]
    run = run_stage(compose([*overrides, *SHORT, *own]), "generator").path
    cfg = compose([*overrides, *SHORT, *own])
    expected = {step: cfg.generator.train.lr * min(step + 1, 4) / 5 for step in range(1, 13)}  # MARDM §3
    assert metrics(run)["optim/lr"] == pytest.approx(expected)


def test_a_tokenizer_of_codes_shows_reconstructions_and_the_use_of_its_codes(overrides):
    run = run_stage(compose([*overrides, *SHORT, "method=momask"]), "tokenizer").path
    kept = check_all_dashboards(run)
    assert list(kept["codes/used"]) == [5, 10, 12]
    page = (run / "samples" / "step-0000012.html").read_text()
    assert page.count("<canvas") == 4  # two clips and what is made of them
    counts = json.loads((run / "samples" / "step-0000012-codes.json").read_text())
    used = [sum(count > 0 for count in layer) for layer in counts.values()]
    assert sum(used) / len(used) == kept["codes/used"][12]
    rows, board = wandb_rows(run), events(run)
    for name, layer in counts.items():
        assert rows[12][f"codes/{name}/values"] == layer
        (shown,) = [e.histogram_value for e in board.Histograms(f"codes/{name}") if e.step == 12]
        assert shown.bucket == layer
        assert shown.num == sum(layer)


@pytest.mark.slow
@pytest.mark.skipif(not films_here(), reason="films need matplotlib and imageio-ffmpeg")
def test_films_are_logged_where_ffmpeg_is(overrides):
    own = ["callbacks.samples_every=12", "callbacks.sample_films=1"]
    run = run_stage(compose([*overrides, *SHORT, *own]), "tokenizer")
    (film,) = (run.path / "samples").glob("*.mp4")
    assert film.name == "step-0000012-film0.mp4"
    assert wandb_rows(run.path)[12]["film0/path"].endswith(".mp4")
    (image,) = events(run.path).Images("film0")
    assert (image.step, image.encoded_image_string[:6]) == (12, b"GIF89a")


def test_a_resumed_run_has_every_step_once(overrides, monkeypatch):
    """It dies at step 11 and resumes from a checkpoint of step 8: what it showed of 9 to 11 must go."""

    class Dying(fitting.Checkpoints):
        def on_train_batch_end(self, trainer, *rest):
            super().on_train_batch_end(trainer, *rest)
            if trainer.global_step == 11:
                raise RuntimeError("the machine died")

    cfg = compose([*overrides, *SHORT, "tokenizer.train.checkpoint_every=50"])
    with monkeypatch.context() as patch:
        patch.setattr(fitting, "Checkpoints", Dying)
        with pytest.raises(RuntimeError, match="died"):
            run_stage(cfg, "tokenizer")
    run = run_stage(cfg, "tokenizer").path
    kept = check_all_dashboards(run)
    assert list(kept["train/loss"]) == [2, 4, 6, 8, 10, 12]
    assert [step for step, row in wandb_rows(run).items() if "samples/path" in row] == [5, 10, 12]


def test_a_run_that_lacks_nothing_but_its_weights_keeps_what_it_showed(overrides, monkeypatch):
    """It dies behind the last step: the resumed one has none left to run."""
    cfg = compose([*overrides, *SHORT, "tokenizer.train.checkpoint_every=12"])
    with monkeypatch.context() as patch:
        patch.setattr("kinema.runs.weights.save", lambda *_, **__: pytest.fail("the machine died"))
        with pytest.raises(pytest.fail.Exception, match="died"):
            run_stage(cfg, "tokenizer")
    assert (stage_folder(cfg, get_stage("tokenizer")).path / "checkpoints" / "last.ckpt").exists()
    kept = check_all_dashboards(run_stage(cfg, "tokenizer").path)
    assert list(kept["train/loss"]) == [2, 4, 6, 8, 10, 12]


@pytest.mark.parametrize(("stage", "method"), [("generator", "mardm_sit"), ("tokenizer", "mmm")])
def test_looking_changes_neither_name_nor_weights_of_a_run(stage, method, overrides, tmp_path):
    brief = [*overrides, *SHORT, f"method={method}", f"{stage}.train.ema=0.9", "callbacks.score_every=3"]
    seen = run_stage(compose([*brief, "logger.names=[csv,tensorboard]"]), stage)
    blind = [*overrides, *SHORT, f"method={method}", f"{stage}.train.ema=0.9", "callbacks=none", "logger=none"]
    blind = [o for o in blind if not o.startswith(("callbacks.", "logger."))]
    other = run_stage(compose([*blind, f"paths.runs={tmp_path}/blind"]), stage)
    assert seen.path.name == other.path.name
    assert len(list((seen.path / "samples").glob("*.html"))) == 3
    assert not (other.path / "samples").exists()
    assert not (tmp_path / "blind" / "matching").exists()  # nobody asked for a judge
    ours, theirs = load_file(seen.weights), load_file(other.weights)
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        assert torch.equal(ours[name], value), name


def test_weights_of_the_least_fid_are_kept(overrides):
    brief = [*overrides, *SHORT, "logger=none", "generator.train.select=fid", "callbacks.score_every=3"]
    run = run_stage(compose(brief), "generator")
    scores = metrics(run.path)["score/fid"]
    assert list(scores) == [3, 6, 9, 12]
    assert {"score/r1", "score/r3", "score/matching"} <= metrics(run.path).keys()
    assert run.status["step"] == min(scores, key=lambda step: scores[step])
    assert run.status["val_loss"] is None  # it was not what chose


def test_weights_that_no_score_chose_are_not_kept_in_its_name(overrides, monkeypatch):
    def refuse(*_):
        raise ValueError("this judge never saw that")

    monkeypatch.setattr("kinema.experiments.watching.ValidationScores.__call__", refuse)
    brief = [*overrides, *SHORT, "logger=none", "generator.train.select=fid", "callbacks.score_every=6"]
    with pytest.raises(ValueError, match="select=fid keeps the best of the weights, and none had a fid"):
        run_stage(compose(brief), "generator")


def test_a_process_that_is_not_the_first_looks_at_nothing_and_is_no_error(overrides, monkeypatch):
    """Of two processes the first scores and writes; the other ends in order."""
    monkeypatch.setattr(Observer, "on_train_batch_end", lambda *_: None)
    monkeypatch.setattr(Trainer, "is_global_zero", property(lambda _: False))
    brief = [*overrides, *SHORT, "logger=none", "generator.train.select=fid", "callbacks.score_every=6"]
    assert run_stage(compose(brief), "generator").weights


@pytest.mark.parametrize("stage", ["generator", "tokenizer"])
def test_no_samples_are_drawn_of_no_clips(overrides, stage):
    cfg = compose([*overrides, *SHORT, "logger=none", "callbacks.sample_prompts=0"])
    assert not (run_stage(cfg, stage).path / "samples").exists()


@pytest.mark.parametrize("stage", ["generator", "tokenizer"])
def test_a_score_that_nobody_computes_selects_nothing(overrides, stage):
    with pytest.raises(ValueError, match=rf"{stage}.train.select=fid .* set callbacks.score_every"):
        run_stage(compose([*overrides, f"{stage}.train.select=fid"]), stage)


def test_a_cached_run_says_where_its_dashboards_are_and_gets_those_it_lacks(overrides, capsys):
    plain = [*overrides, *SHORT, "logger.names=[csv]"]
    run = run_stage(compose(plain), "tokenizer").path
    assert not (run / "logs" / "wandb").exists()
    run_stage(compose([*overrides, *SHORT]), "tokenizer")
    check_all_dashboards(run)
    said = capsys.readouterr().out
    for place in ("logs/csv", "logs/tensorboard", "logs/wandb/offline-run-"):
        assert f"dashboard {run}/{place}" in said


def test_an_evaluation_is_shown_with_its_motions(overrides):
    own = ["source=real", "scale.protocol.replications=2", "logger.group=mine", "evaluator.matching.train.steps=8"]
    row = run_evaluation(compose([*overrides, *SHORT, *own], "evaluate"))
    folder = row.folder.path
    rows, board = wandb_rows(folder), events(folder)
    for number, line in enumerate(row.lines):
        for key, value in line["metrics"].items():
            assert rows[number][key] == pytest.approx(value, nan_ok=True)
            assert board.Scalars(key)[number].step == number
    assert "samples/path" in rows[0]
    (run,) = [r.run for r in wandb_records(folder) if r.WhichOneof("record_type") == "run"]
    assert (run.run_group, run.job_type, sorted(run.tags)) == (
        "mine",
        "evaluation",
        ["mardm_sit", "smoke", "synthetic"],
    )


def test_a_table_is_shown_with_the_published_numbers(overrides, tmp_path):
    texts = {"table.md": "# Table\n\n| | FID |", "table.csv": "key,fid,fid_paper\nmdm,.5,.518\n", "index.html": "<p>"}
    written = []
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        written.append(tmp_path / name)
    show_table(compose([*overrides, *SHORT]), "table5", "0123456789ab", written)
    (text,) = events(tmp_path).Tensors("table5/text_summary")
    assert text.tensor_proto.string_val[0].decode() == texts["table.md"]
    rows = wandb_rows(tmp_path)
    (path,) = [row["table5/path"] for row in rows.values() if "table5/path" in row]
    (media,) = tmp_path.glob(f"logs/wandb/offline-run-*/files/{path}")
    shown = json.loads(media.read_text())
    assert shown["columns"] == ["key", "fid", "fid_paper"]
    assert shown["data"] == [["mdm", ".5", ".518"]]
    (run,) = [r.run for r in wandb_records(tmp_path) if r.WhichOneof("record_type") == "run"]
    assert (run.run_group, run.job_type) == ("table5", "table")


def test_a_page_is_shown(overrides, tmp_path):
    (tmp_path / "index.html").write_text("<p>curves")
    show_page(compose([*overrides, *SHORT], "evaluate"), "solvers", "0123456789ab", [tmp_path / "index.html"])
    (text,) = events(tmp_path).Tensors("solvers/text_summary")
    assert text.tensor_proto.string_val[0].decode() == f"`{tmp_path / 'index.html'}`"
    assert [row for row in wandb_rows(tmp_path).values() if "solvers/path" in row]
    (run,) = [r.run for r in wandb_records(tmp_path) if r.WhichOneof("record_type") == "run"]
    assert (run.run_group, run.job_type) == ("solvers", "page")


def test_weights_are_kept_as_an_artifact_if_asked_for(overrides):
    run = run_stage(compose([*overrides, *SHORT, "logger.artifacts=true"]), "tokenizer").path
    (artifact,) = [r.artifact for r in wandb_records(run) if r.WhichOneof("record_type") == "artifact"]
    assert (artifact.name, artifact.type) == (run.name, "model")
    assert {entry.path for entry in artifact.manifest.contents} == {"weights.safetensors", "config.yaml"}


def test_more_codes_than_wandb_has_bins_are_put_together(tmp_path):
    counts = tmp_path / "step-0000003-codes.json"
    counts.write_text(json.dumps({"layer_1": [2, 1] * 512}))
    with dashboards(kinds(["wandb"]), tmp_path, About("a-run-0123456789ab")) as (board,):
        board.show(3, "codes", counts)
    assert wandb_rows(tmp_path)[3]["codes/layer_1/values"] == [3] * 512
