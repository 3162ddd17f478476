"""What a split tests: takes, frames and captions that training has, on miniatures whose overlaps are known."""

from __future__ import annotations

import numpy as np
import pytest

from kinema.data.doctor import diagnose
from kinema.data.leakage import CAPTION, FRAMES, TAKE, Nearness, frames_seen, takes_seen
from kinema.data.origin import ORIGIN, Origin, named_origin, read_index
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore

HEAD = "source_path,start_frame,end_frame,new_name\n"
CUTS = {
    # training: A [0, 100) and [80, 200), B [50, 90)
    "000001": ("train", "./CMU/A.npy", 0, 100),
    "000002": ("train", "./CMU/A.npy", 80, 200),
    "000003": ("train", "./KIT/B.npy", 50, 90),
    "000004": ("train", "./HumanAct12/P1.npy", 0, -1),
    "000005": ("val", "./CMU/C.npy", 0, 100),
    # test: half seen; just touching; all seen, once each by two clips; 10 of 100 seen; validation's take; nothing
    "000006": ("test", "./CMU/A.npy", 150, 250),
    "000007": ("test", "./CMU/A.npy", 200, 260),
    "000008": ("test", "./CMU/A.npy", 60, 140),
    "000009": ("test", "./KIT/B.npy", 80, 180),
    "000010": ("test", "./CMU/C.npy", 50, 150),
    "000011": ("test", "./HumanAct12/P2.npy", 0, -1),
}
SHARES = {"000006": 0.5, "000007": 0, "000008": 1, "000009": 0.1, "000010": 0, "000011": 0}
TOLD = (
    "of 6 unmirrored test clips 4 (66.7%) are of a take that training has, 3 (50.0%) share frames with a training "
    "clip, 2 (33.3%) at least half of theirs"
)


def index() -> str:
    return HEAD + "".join(f"{take},{start},{stop},{name}.npy\n" for name, (_, take, start, stop) in CUTS.items())


@pytest.fixture
def lists(tmp_path):
    """Give the lists of a miniature HumanML3D as its repository has them: no motions, and index.csv a folder above."""
    folder = tmp_path / "HumanML3D"
    folder.mkdir()
    for split in ("train", "val", "test"):
        names = [name for name, cut in CUTS.items() if cut[0] == split]
        (folder / f"{split}.txt").write_text("".join(f"{name}\nM{name}\n" for name in names))
    (tmp_path / "index.csv").write_text(index())
    return folder


@pytest.fixture
def official(official_corpus, tmp_path) -> PackedStore:
    """Give the miniature with motions: rows are one fewer than frames, a part of 000006 has a caption of its own."""
    clips = {}
    for name, (split, _, start, stop) in CUTS.items():
        rows = (stop - start if stop > start else 80) - 1
        own = "a person turns#a/DET#0.0#0.0\n" if name in ("000008", "000001") else f"take {name}#a/DET#0.0#0.0\n"
        clips[name] = clips[f"M{name}"] = (split, rows, own)
    clips["000006"] = ("test", 99, "take 6#a/DET#0.0#0.0\nits end#a/DET#2.5#4.75\n")
    root = official_corpus(clips)
    (tmp_path / "index.csv").write_text(index())
    return PackedStore.open(prepare_store("official", root, tmp_path / "stores", name="mini", mirror=False))


def nearness(findings) -> list[str]:
    return [finding.message for finding in findings if finding.kind == "nearness"]


def test_the_figures_come_from_index_and_lists_alone(lists):
    assert nearness(diagnose(lists)) == [TOLD]
    (lists.parent / "index.csv").unlink()
    assert nearness(diagnose(lists)) == []


def test_a_corpus_tells_the_same_of_its_clips_and_its_captions(official):
    # "a person turns" is said of 000008 and of 000001.
    captions = "of 7 captions of unmirrored test clips 1 (14.3%) occur verbatim in training"
    assert nearness(diagnose(official)) == [TOLD, captions]
    (source,) = official.path.parents[1].glob("official")
    assert nearness(diagnose(source)) == [TOLD, captions]


def test_entries_know_what_of_them_training_has(official):
    found = Nearness.of(official)
    shares = {official.entry_name(e): found.frames[e] for e in official.split_entries("test")}
    mirrored = {f"M{name}": share for name, share in SHARES.items()}
    # The part is rows 50 to 95 of 000006: frames 200 to 245 of the take, none of them in training.
    assert shares == pytest.approx(SHARES | mirrored | {"000006#0": 0})
    entries = [e for e in official.split_entries("test") if official.entry_name(e) in ("000006", "000007", "000010")]
    texts = ["a person turns", "take 000007", "Take 000001"]
    assert found.fields(entries, texts) == {
        CAPTION: ["seen", "unseen", "unseen"],
        TAKE: ["seen", "seen", "unseen"],
        FRAMES: ["at least half", "none", "none"],
    }


def test_the_origin_changes_no_hash_and_a_new_index_is_read(official, tmp_path):
    source = tmp_path / "official"
    (tmp_path / "index.csv").write_text(index().replace("./CMU/A.npy,150", "./CMU/D.npy,150"))
    other = PackedStore.open(prepare_store("official", source, tmp_path / "stores", name="mini", mirror=False))
    assert other.path != official.path
    assert other.hash == official.hash
    assert not Nearness.of(other).take[list(map(other.entry_name, range(other.num_entries))).index("000006")]
    (tmp_path / "index.csv").unlink()
    blind = PackedStore.open(prepare_store("official", source, tmp_path / "stores", name="mini", mirror=False))
    assert blind.hash == official.hash
    assert Nearness.of(blind).fields([0], ["x"]) == {CAPTION: ["unseen"]}
    assert blind.clip_origin(0) is None


def test_pieces_and_mirror_images_are_of_their_take(joints_corpus, tmp_path):
    clips = {"walk_s0": ("train", 180), "walk_s1": ("test", 100), "run": ("test", 70)}
    store = PackedStore.open(prepare_store("joints", joints_corpus(clips), tmp_path / "stores", name="cut"))
    origins = {store.clip_name(i): store.clip_origin(i) for i in range(store.num_clips)}
    assert origins["walk_s1"] == origins["Mwalk_s1"] == Origin("walk", 180, 280)
    assert origins["run"] == Origin("run", 0, 70)
    found = Nearness.of(store)
    by_name = {store.entry_name(e): (found.take[e], found.frames[e]) for e in range(store.num_entries)}
    assert by_name["walk_s1"] == by_name["Mwalk_s1"] == (True, 0.0)
    assert by_name["run"] == (False, 0.0)
    assert by_name["walk_s0"] == (True, 1.0)


def test_shares_are_those_of_counting_frame_by_frame():
    rng = np.random.default_rng(3)

    def draw(count: int) -> np.ndarray:
        rows = np.zeros(count, dtype=ORIGIN)
        rows["take"], rows["start"] = rng.integers(-1, 12, count), rng.integers(0, 60, count)
        rows["stop"] = rows["start"] + rng.integers(1, 30, count)
        return rows

    tested, trained = draw(200), draw(25)
    seen = {(t, f) for t, a, b in trained.tolist() for f in range(a, b) if t >= 0}
    counted = [np.mean([(t, f) in seen for f in range(a, b)]) for t, a, b in tested.tolist()]
    np.testing.assert_allclose(frames_seen(tested, trained), counted, atol=1e-12)
    assert takes_seen(tested, trained).tolist() == [t >= 0 and t in trained["take"] for t in tested["take"].tolist()]
    assert 0 < np.mean(np.array(counted) > 0) < 1
    assert not frames_seen(tested, trained[:0]).any()


def test_an_index_with_odd_frames_is_refused(tmp_path):
    (tmp_path / "index.csv").write_text(f"{HEAD}./CMU/A.npy,soon,100,000001.npy\n")
    with pytest.raises(ValueError, match=r"000001.npy has start_frame 'soon'.*write numbers"):
        read_index(tmp_path)
    assert named_origin("cmu_02_01") == Origin("cmu_02_01")


@pytest.mark.shared
@pytest.mark.slow
def test_the_compositional_split_shares_no_take(open_mocap, tmp_path):
    store = prepare_store("joints", open_mocap, tmp_path, name="open_mocap", split="compositional")
    told = nearness(diagnose(store))  # those of the corpus' own split: test_doctor.py
    assert told[0].startswith("of 660 unmirrored test clips 0 (0.0%) are of a take")
    assert "685" in told[1]
