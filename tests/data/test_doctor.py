"""The doctor: finds what was planted, says how to mend it, and has nothing to say about a clean corpus."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from kinema.data.catalog import read_joints_folder, read_official
from kinema.data.doctor import Finding, diagnose, exit_code, format
from kinema.data.doctor.likeness import nearest
from kinema.data.prepare import prepare
from kinema.data.store import PackedStore
from kinema.data.synthetic import synthetic_clips, write_joints_folder, write_official_folder
from kinema.motion.skeleton import HUMANML3D

TAMPERED = "a person waves#a/DET person/NOUN wave/VERB#0.0#0.0\n"


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    """Give an official folder of 48 clips and their mirror images."""
    return write_official_folder(synthetic_clips(size=48, seed=5), tmp_path_factory.mktemp("clean") / "corpus")


@pytest.fixture
def folder(clean, tmp_path) -> Path:
    """Give a copy that may be spoilt."""
    return Path(shutil.copytree(clean, tmp_path / "corpus"))


def names(folder: Path, split: str) -> list[str]:
    """Give the original clips of a split."""
    return [n for n in (folder / f"{split}.txt").read_text().split() if not n.startswith("M")]


def edit(file: Path, change) -> None:
    """Rewrite a text file."""
    file.write_text(change(file.read_text()))


def rows(folder: Path, name: str) -> Path:
    """Name a clip's file of features."""
    return folder / "new_joint_vecs" / f"{name}.npy"


def rename(folder: Path, split: str, old: str, new: str) -> None:
    """Rename a clip everywhere."""
    rows(folder, old).rename(rows(folder, new))
    (folder / "texts" / f"{old}.txt").rename(folder / "texts" / f"{new}.txt")
    edit(folder / f"{split}.txt", lambda text: "".join(f"{new if n == old else n}\n" for n in text.split()))


def bad(findings: list[Finding]) -> list[Finding]:
    """Keep what is worse than information."""
    return [f for f in findings if f.severity != "info"]


def lose_a_file(folder):
    rows(folder, names(folder, "train")[0]).unlink()


def lose_many_files(folder):
    for name in names(folder, "train")[:8]:
        rows(folder, name).unlink()


def put_nan(folder):
    file = rows(folder, names(folder, "train")[0])
    broken = np.load(file)
    broken[5, 7] = np.nan
    np.save(file, broken)


def list_twice(folder):
    edit(folder / "test.txt", lambda text: text + names(folder, "train")[0] + "\n")


def test_motion_in_train(folder):
    np.save(rows(folder, names(folder, "train")[0]), np.load(rows(folder, names(folder, "test")[0])))


def nearly_test_motion_in_train(folder):
    twin = np.load(rows(folder, names(folder, "test")[0]))
    twin[:, [3, *range(5, 67, 3)]] += 0.004
    np.save(rows(folder, names(folder, "train")[0]), twin)


def one_motion_twice(folder):
    one, other = names(folder, "train")[:2]
    np.save(rows(folder, one), np.load(rows(folder, other)))


def cut_across_splits(folder):
    rename(folder, "train", names(folder, "train")[0], "take_s0")
    rename(folder, "test", names(folder, "test")[0], "take_s1")


def mirror_in_another_split(folder):
    name = "M" + names(folder, "test")[0]
    edit(folder / "test.txt", lambda text: text.replace(f"{name}\n", ""))
    edit(folder / "train.txt", lambda text: text + f"{name}\n")


def cut_one_recording(folder):
    lines = [f"./CMU/1.npy,0,1,{names(folder, split)[0]}.npy" for split in ("train", "test")]
    (folder / "index.csv").write_text("\n".join(["source_path,start_frame,end_frame,new_name", *lines]))


def take_published_statistics(folder):
    std = np.load(folder / "Std.npy")
    std[:4] /= 25
    std[-4:] /= 25
    np.save(folder / "Std.npy", std)


def forget_to_average(folder):
    std = np.load(folder / "Std.npy")
    std[HUMANML3D.groups["joints"]] *= np.linspace(0.5, 1.5, 63)
    np.save(folder / "Std.npy", std)


def take_other_statistics(folder):
    np.save(folder / "Mean.npy", np.load(folder / "Mean.npy") + 0.3)


def take_narrow_statistics(folder):
    for name in ("Mean.npy", "Std.npy"):
        np.save(folder / name, np.load(folder / name)[:67])


def empty_captions(folder):
    (folder / "texts" / f"{names(folder, 'train')[0]}.txt").write_text("")


def spoil_a_line(folder):
    edit(folder / "texts" / f"{names(folder, 'train')[0]}.txt", lambda text: text + "a person walks#a/DET#soon#0.0\n")


def never_swap(folder):
    for name in names(folder, "train"):
        shutil.copy(folder / "texts" / f"{name}.txt", folder / "texts" / f"M{name}.txt")


def write_something_else(folder):
    (folder / "texts" / f"M{names(folder, 'train')[0]}.txt").write_text(TAMPERED)


def swap_texts_only(folder):
    for split in ("train", "val", "test"):
        for name in names(folder, split):
            file = folder / "texts" / f"{name}.txt"
            lines = [line.split("#", 1) for line in file.read_text().splitlines()]
            swapped = str.maketrans({"\0": ""})
            text = [
                (t.replace("left", "\0L").replace("right", "left").replace("\0L", "right").translate(swapped), rest)
                for t, rest in lines
            ]
            file.write_text("".join(f"{t}#{rest}\n" for t, rest in text))


def jump(folder):
    file = rows(folder, names(folder, "train")[0])
    broken = np.load(file)
    broken[20:, HUMANML3D.groups["joints"]][:, 0] += 3
    np.save(file, broken)


def measure_in_centimetres(folder):
    for file in (folder / "new_joint_vecs").glob("*.npy"):
        scaled = np.load(file)
        scaled[:, 1:67] *= 100
        np.save(file, scaled)


def empty_a_split(folder):
    (folder / "val.txt").write_text("")


DEFECTS = [
    (lose_a_file, "missing files", "warning"),
    (lose_many_files, "missing files", "error"),
    (put_nan, "unusable clips", "warning"),
    (list_twice, "duplicate names", "error"),
    (test_motion_in_train, "near-duplicates", "error"),
    (nearly_test_motion_in_train, "near-duplicates", "warning"),
    (one_motion_twice, "duplicates", "warning"),
    (cut_across_splits, "leakage", "error"),
    (mirror_in_another_split, "leakage", "error"),
    (cut_one_recording, "leakage", "warning"),
    (take_published_statistics, "statistics", "error"),
    (forget_to_average, "statistics", "error"),
    (take_other_statistics, "statistics", "error"),
    (take_narrow_statistics, "unreadable", "error"),
    (empty_captions, "no captions", "warning"),
    (spoil_a_line, "unreadable captions", "warning"),
    (never_swap, "sides not swapped", "error"),
    (write_something_else, "sides", "warning"),
    (swap_texts_only, "sides in tokens", "error"),
    (jump, "jumps", "warning"),
    (measure_in_centimetres, "unit", "error"),
    (empty_a_split, "empty split", "error"),
]


@pytest.mark.parametrize(("plant", "kind", "severity"), DEFECTS, ids=[d[0].__name__ for d in DEFECTS])
def test_each_defect_is_found_with_a_fix(folder, plant, kind, severity):
    plant(folder)
    found = [f for f in diagnose(folder) if f.kind == kind]
    assert [f.severity for f in found] == [severity]
    assert found[0].fix
    assert exit_code(found) == (severity == "error")
    assert exit_code(found, strict=True) == 1


def test_a_clean_corpus_is_clean_as_folder_and_as_store(clean, tmp_path):
    store = prepare(read_official(clean), tmp_path / "store", name="clean", mirror=False)
    for target in (clean, store, PackedStore.open(store)):
        findings = diagnose(target)
        assert bad(findings) == []
        assert exit_code(findings, strict=True) == 0
        assert "nothing is wrong" in format(findings)
    assert bad(diagnose(store, source=clean)) == []
    with pytest.raises(FileNotFoundError, match=r"train\.txt"):
        diagnose(store, source=tmp_path)


def test_a_store_is_compared_with_its_source(folder, tmp_path):
    store = prepare(read_official(folder), tmp_path / "store", name="whole", mirror=False)
    lose_a_file(folder)
    np.save(rows(folder, "unheard-of"), np.zeros((50, 263)))
    cut_one_recording(folder)
    kinds = {f.kind: f.severity for f in diagnose(store, source=folder)}
    assert kinds["missing files"] == kinds["leakage"] == "warning"
    assert kinds["unlisted files"] == "info"


@pytest.mark.parametrize("skeleton", ["humanml3d", "kit"])
def test_a_store_of_joints_is_clean_and_counted(tmp_path, skeleton):
    folder = write_joints_folder(synthetic_clips(size=30, seed=6, skeleton=skeleton), tmp_path / "joints-corpus")
    assert bad(diagnose(folder)) == []
    store = prepare(read_joints_folder(folder), tmp_path / "store", name="joints", skeleton=skeleton)
    findings = diagnose(store)
    assert bad(findings) == []
    told = next(f.message for f in findings if f.kind == "counts")
    assert "train 48 clips (24 mirrored), " in told


def test_what_a_store_left_out_is_told(folder, tmp_path):
    put_nan(folder)
    lose_a_file_of = names(folder, "train")[1]
    rows(folder, lose_a_file_of).unlink()
    store = prepare(read_official(folder), tmp_path / "store", name="left", mirror=False)
    kinds = {f.kind: f for f in diagnose(store)}
    assert names(folder, "train")[0] in kinds["unusable clips"].items[0]
    assert lose_a_file_of in kinds["missing files"].items[0]


def test_one_file_of_joints_is_examined(tmp_path):
    joints = next(synthetic_clips(size=1)).joints()
    np.save(tmp_path / "good.npy", joints)
    assert bad(diagnose(tmp_path / "good.npy")) == []
    np.save(tmp_path / "jump.npy", np.concatenate([joints, joints + 5]))
    assert [f.kind for f in bad(diagnose(tmp_path / "jump.npy"))] == ["jump"]
    np.save(tmp_path / "odd.npy", joints[:, :13])
    assert exit_code(diagnose(tmp_path / "odd.npy")) == 1


def test_what_is_no_corpus_is_refused_or_explained(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        diagnose(tmp_path / "nowhere")
    assert [f.kind for f in diagnose(tmp_path)] == ["unreadable"]


def test_nearest_finds_the_exact_mean_joint_distance():
    rng = np.random.default_rng(0)
    base = rng.normal(size=(200, 60)).astype(np.float32)
    queries = base[[7, 90]] + np.float32(0.01)
    index, distance = nearest(queries, base)
    assert index.tolist() == [7, 90]
    np.testing.assert_allclose(distance, 0.01 * np.sqrt(3), rtol=1e-3)
    index, _ = nearest(base, base, itself=True)
    assert not (index == np.arange(200)).any()


def test_findings_are_written_worst_first_and_cut_short():
    text = format([Finding("info", "counts", "ten"), Finding("error", "leakage", "bad", "mend it", tuple("abcdefgh"))])
    lines = text.splitlines()
    assert lines[0].startswith("error   leakage: bad")
    assert "and 3 more" in lines[1]
    assert "fix: mend it" in lines[2]
    assert lines[-1] == "doctor: 1 error, 0 warnings"


@pytest.mark.shared
@pytest.mark.slow
def test_open_mocap_has_no_errors(open_mocap):
    findings = diagnose(open_mocap)
    assert exit_code(findings) == 0
    assert {f.kind for f in bad(findings)} == {"near-duplicates", "duplicates"}
    told = [finding.message for finding in findings if finding.kind == "nearness"]
    assert told[0].startswith("of 426 unmirrored test clips 0 (0.0%) are of a take")
    assert "844 (66.0%)" in told[1]  # of a store, which cleans captions, more
