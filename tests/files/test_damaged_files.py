"""Every file that is read back, damaged in many ways: one clear error that names it, or the right result."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from kinema.atomic import write_json
from kinema.data.captions import parse_captions
from kinema.data.catalog import Clip, read_joints_folder
from kinema.data.prepare import prepare
from kinema.data.store import FILES, PackedStore
from kinema.evaluation.cache import Shelf
from kinema.experiments.config import read_config
from kinema.experiments.figures.code_usage import CONFIG
from kinema.experiments.replications import scored_lines
from kinema.interop.checkpoint import read_checkpoint
from kinema.motion.statistics import Statistics
from kinema.report.index import write_site
from kinema.report.motions import read_samples
from kinema.runs import weights
from kinema.runs.folder import RunFolder
from kinema.runs.lines import append_line, read_lines
from kinema.runs.parts import link, read_text_encoder, upstream, write_text_encoder
from kinema.text.cache import CachedTextEncoder
from kinema.text.hashed import HashedTextEncoder
from kinema.text.words import word_vectors
from kinema.training.checkpoint import CONTENT, AtomicCheckpointIO
from kinema.training.dashboards.base import About, Dashboard
from kinema.training.latents import LatentCache
from kinema.training.record import LINE

Read = Callable[[Path], object]


def statuses(folder: Path) -> Read:
    RunFolder(folder).mark("done", step=3, seconds=1.5, val_loss=None, versions={"torch": "2"})
    return lambda file: (RunFolder(folder).done, RunFolder(folder).status["state"])


def links(folder: Path) -> Read:
    link(folder, {"tokenizer": folder / "other", "length": folder.parent})
    return lambda file: upstream(folder)


def texts(folder: Path) -> Read:
    write_text_encoder(folder, "hashed", None)
    return lambda file: read_text_encoder(folder)["encoder"]


def scores(folder: Path) -> Read:
    for i in range(3):
        line = {"replication": i, "metrics": {"fid": 0.5}, "breakdowns": {"by": {"a": {"fid": 1.0}}}, "seconds": 1.0}
        append_line(folder / "replications.jsonl", {**line, "provenance": {}})
    return lambda file: sorted((r["replication"], sum(r["metrics"].values())) for r in scored_lines(folder))


def numbers(folder: Path) -> Read:
    for i in range(3):
        append_line(folder / "metrics.jsonl", {"step": i, "train/loss": 0.5})
    return lambda file: sorted(line["step"] for line in read_lines(file, LINE))


def config(folder: Path) -> Read:
    text = "tokenizer: {name: vq}\nseed: 0\nscale: {name: tiny}\npaths: {stores: stores}\n"
    text += "data:\n  name: x\n  reader: joints\n  skeleton: kit\n  options: {}\n"
    (folder / "config.yaml").write_text(text)
    return lambda file: read_config(folder, CONFIG)


def clips(folder: Path) -> Read:
    (folder / "joints").mkdir()
    for name in ("a", "b"):
        np.save(folder / "joints" / f"{name}.npy", np.zeros((3, 22, 3), np.float32))
    for part, name in (("train", "a"), ("val", "b"), ("test", "")):
        (folder / f"{part}.txt").write_text(name)
    write_json(folder / "manifest.json", [{"name": "a", "source": "x", "fps": 20}, {"name": "b", "fps": None}])
    return lambda file: [clip.fields for clip in read_joints_folder(folder)]


SHAPES = {"model.weight": torch.zeros(3, 2)}


def checkpoint(folder: Path) -> Read:
    files = AtomicCheckpointIO(SHAPES)
    content = {"pytorch-lightning_version": "2.6", "epoch": 0, "global_step": 3, "state_dict": SHAPES}
    content |= {"loops": {}, "callbacks": {}, "optimizer_states": [{"state": {}}], "lr_schedulers": []}
    files.save_checkpoint(content, folder / "last.ckpt")
    return lambda file: files.load_checkpoint(file)["global_step"]


@pytest.mark.parametrize("key", CONTENT)
@pytest.mark.parametrize("value", [None, 3, "x", [1], {"a": 1}, True, torch.zeros(2)], ids=repr)
def test_every_key_of_a_checkpoint_is_of_its_kind(tmp_path, key, value):
    checkpoint(tmp_path)
    path, files = tmp_path / "last.ckpt", AtomicCheckpointIO(SHAPES)
    content = torch.load(path, weights_only=True)
    torch.save({**content, key: value}, path)
    if isinstance(value, CONTENT[key]) and type(value) is not bool and key != "state_dict":
        assert files.load_checkpoint(path)[key] == value
        return
    with pytest.raises(ValueError, match=rf"last\.ckpt (has '{key}': it holds|is of another model: )") as told:
        files.load_checkpoint(path)
    assert "\n" not in str(told.value)


def module(folder: Path) -> Read:
    save = nn.Linear(2, 3)
    weights.save(
        save, {"_target_": "kinema.generators.length.LengthEstimator"}, folder / "weights.safetensors", part="length"
    )
    return lambda file: weights.read_meta(file)["spec"]


def published(folder: Path, name: str, write: Callable[[dict, Path], None]) -> Read:
    write({"a.weight": torch.arange(6.0).reshape(2, 3), "b": torch.zeros(2)}, folder / name)
    return lambda file: sorted(read_checkpoint(file))


def latents(folder: Path) -> Read:
    np.save(folder / "values.npy", np.ones((5, 4), np.float32))
    np.save(folder / "keys.npy", np.array([(0, 0, 8), (1, 0, 12)]))
    np.save(folder / "offsets.npy", np.array([0, 2, 5]))
    write_json(folder / "meta.json", {"dim": 4, "discrete": False, "drawn": False, "crops": 2})
    return lambda file: LatentCache(folder).range()


def shelf(folder: Path) -> Read:
    kept = Shelf(folder / "c-s0-r000.npz")
    for key in ("motion-1", "text-1"):
        kept.get(key, lambda: torch.ones(3, 2), torch.device("cpu"))
    kept.save()

    def read(file: Path) -> object:
        found = Shelf(file).get("motion-1", lambda: torch.ones(3, 2), torch.device("cpu"))
        return found.shape

    return read


def samples(folder: Path) -> Read:
    arrays = {"texts": np.array(["a", "b"]), "skeleton": np.array("humanml3d"), "kept1": np.ones(6, bool)}
    np.savez(folder / "samples.npz", joints0=np.ones((4, 22, 3), "f4"), joints1=np.ones((6, 22, 3), "f4"), **arrays)
    return lambda file: [(m.text, m.joints.shape) for m in read_samples(file)]


def statistics(folder: Path) -> Read:
    Statistics(np.zeros(67), np.ones(67)).save(folder / "statistics.npz")
    return lambda file: Statistics.load(file).mean.shape


def mean(folder: Path) -> Read:
    for name in ("Mean", "Std"):
        np.save(folder / f"{name}.npy", np.ones(263, np.float32))
    return lambda file: Statistics.load(folder).mean.ndim


def words(folder: Path) -> Read:
    names = ["sos", "eos", "unk", "walk"]
    np.save(folder / "our_vab_data.npy", np.ones((4, 5), np.float32))
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(names))
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps({n: i for i, n in enumerate(names)}))
    return lambda file: word_vectors("our_vab", folder)


def features(folder: Path) -> Read:
    made = CachedTextEncoder(HashedTextEncoder(), folder)
    made(["a person walks", "a person sits"])
    for file in made.folder.iterdir():
        file.rename(folder / file.name)
    made.folder.rmdir()

    def read(file: Path) -> object:
        shutil.copytree(folder, made.folder)
        try:
            cached = CachedTextEncoder(HashedTextEncoder(), folder)
            return cached(["a person walks", "a person jumps"]).pooled.shape
        finally:
            shutil.rmtree(made.folder)

    return read


def table(folder: Path) -> Read:
    row = {"key": "a", "label": "a", "kind": "method", "note": "", "published": {"fid": 2.0}, "results": [{"fid": 1.0}]}
    columns = [{"key": "fid", "label": "FID", "better": "lower", "digits": 2}]
    write_json(
        folder / "table.json", {"name": "t", "title": "T", "columns": columns, "rows": [row], "footnotes": ["x"]}
    )
    return site(folder)


def page(folder: Path) -> Read:
    section = {"name": "part", "title": "x", "text": "y", "image": "", "rows": [{"a": "b", "n": 3}]}
    write_json(folder / "page.json", {"title": "T", "lead": "x", "sections": [section], "provenance": {"a": "b"}})
    return site(folder)


def site(folder: Path) -> Read:
    """Read a report through the site of the folder above, which is written whole or not at all."""

    def read(file: Path) -> object:
        before = sorted(p for p in folder.parent.rglob("*") if p.suffix == ".html")
        for path in before:
            path.unlink()
        try:
            write_site(folder.parent)
        except ValueError:
            assert not list(folder.parent.rglob("*.html"))
            raise
        return None

    return read


class Shown(Dashboard):
    name = "shown"


def counts(folder: Path) -> Read:
    write_json(folder / "step-0000001-codes.json", {"layer_1": [1, 2, 3]})
    (folder / "shown").mkdir()
    shown = Shown(folder / "shown", About("x"))
    return lambda file: shown.show(1, "codes", file)


KINDS: dict[str, tuple[Callable[[Path], Read], tuple[str, ...]]] = {
    "status": (statuses, ("status.json",)),
    "links": (links, ("upstream.json",)),
    "text encoder": (texts, ("text.json",)),
    "replications": (scores, ("replications.jsonl",)),
    "metrics": (numbers, ("metrics.jsonl",)),
    "config": (config, ("config.yaml",)),
    "corpus": (clips, ("manifest.json",)),
    "checkpoint": (checkpoint, ("last.ckpt",)),
    "weights": (module, ("weights.safetensors",)),
    "torch": (lambda f: published(f, "net.pth", torch.save), ("net.pth",)),
    "old torch": (lambda f: published(f, "net.tar", old), ("net.tar",)),
    "safetensors": (lambda f: published(f, "net.safetensors", save_file), ("net.safetensors",)),
    "latents": (latents, ("meta.json", "values.npy", "keys.npy", "offsets.npy")),
    "embeddings": (shelf, ("c-s0-r000.npz",)),
    "samples": (samples, ("samples.npz",)),
    "statistics": (statistics, ("statistics.npz",)),
    "published statistics": (mean, ("Mean.npy", "Std.npy")),
    "words": (words, ("our_vab_data.npy", "our_vab_words.pkl", "our_vab_idx.pkl")),
    "text features": (features, ("encoder.json", "index.bin", "pooled.bin", "tokens.bin")),
    "table": (table, ("table.json",)),
    "page": (page, ("page.json",)),
    "code counts": (counts, ("step-0000001-codes.json",)),
}


def old(state: dict, file: Path) -> None:
    torch.save(state, file, _use_new_zipfile_serialization=False)


def outcome(read: Read, file: Path) -> str | None:
    """Return the error of a reading, None where it gives something; any other exception is raised."""
    try:
        read(file)
    except (ValueError, FileNotFoundError) as error:
        return str(error)
    return None


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, (_, names) in KINDS.items() for name in names])
def test_a_damaged_file_is_one_line_that_names_it_or_read_right(tmp_path, damages, kind, name, record_property):
    folder = tmp_path / "reports" / kind.replace(" ", "_")
    folder.mkdir(parents=True)
    read = KINDS[kind][0](folder)
    file = folder / name
    good = file.read_bytes()
    assert outcome(read, file) is None
    told: dict[str, str | None] = {}
    for what, content in damages(good, name, 0):
        file.write_bytes(content)
        try:
            told[what] = outcome(read, file)
        except Exception as error:
            pytest.fail(f"{name}, {what}: {type(error).__name__}: {error}")
        if not made_again(kind):
            assert file.read_bytes() == content, what
    record_property("inputs", len(told))
    odd = {w: e for w, e in told.items() if e is not None and ("\n" in e or not (name in e or folder.name in e))}
    assert not odd
    assert not [e for e in told.values() if e is not None and ("unsafely" in e or "weights_only" in e)]
    if not made_again(kind):
        assert sum(e is not None for e in told.values()) > len(told) // 3
        assert told["empty"] or name.endswith(".jsonl")
    assert not [p for p in folder.rglob(".*") if p.name != ".lock"]


def made_again(kind: str) -> bool:
    return kind in ("embeddings", "text features")


def content_of(store: PackedStore) -> str:
    parts = [store.clips.tolist(), store.entries.tolist(), store.dropped, store.statistics.digest()]
    parts += [[store.entry_captions(e) for e in range(store.num_entries)], store.features.tolist()]
    parts += [[store.clip_field(c, "source") for c in range(store.num_clips)], store.hash]
    return repr(parts)


@pytest.mark.parametrize("name", ["manifest.json", "verified.json", *sorted(FILES)])
def test_a_damaged_store_is_one_line_that_names_the_file_or_read_right(tmp_path, damages, name, record_property):
    values = np.linspace(0, 1, 20 * 263, dtype=np.float32).reshape(20, 263)
    captions = parse_captions("a person walks#a/DET person/NOUN walk/VERB#0.0#0.0")
    clips = [Clip(f"c{i}", "train", captions, {"source": "mocap"}, features=lambda: values) for i in range(3)]
    path = prepare(clips, tmp_path / "store", name="x", mirror=False, request="r")
    right, good = content_of(PackedStore.open(path)), (path / name).read_bytes()
    told = {}
    for what, content in damages(good, name, 1):
        (path / name).write_bytes(content)
        try:
            error = outcome(lambda file: PackedStore.open(path), path)
        except Exception as odd:
            pytest.fail(f"{name}, {what}: {type(odd).__name__}: {odd}")
        assert error is None or (name in error and "\n" not in error), what
        told[what] = error
        if error is None and name != "manifest.json":
            assert content_of(PackedStore.open(path)) == right, what
    record_property("inputs", len(told))
    if name in FILES:
        assert all(told.values())
