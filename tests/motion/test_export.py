"""Check that motions saved come back, films have their frames, and nothing half-written stays behind."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from kinema.atomic import replacing
from kinema.motion import export
from kinema.motion.formats.arrays import load_npy, load_npz
from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.types import Motion


@pytest.fixture
def motion(wander) -> Motion:
    joints = wander(HUMANML3D, 12).astype(np.float32)
    features = np.random.default_rng(0).normal(size=(12, 263)).astype(np.float32)
    return Motion(joints, features, "someone waves | ü", "humanml3d", 20.0, seed=7)


@pytest.mark.parametrize("seed", [7, None])
def test_npz_round_trip(motion, tmp_path, seed):
    kept = None if seed is None else np.arange(len(motion.joints)) < 3
    back = export.load_npz(export.save(replace(motion, seed=seed, kept=kept), tmp_path / "new" / "m.npz"))
    assert np.array_equal(back.kept, kept)
    np.testing.assert_array_equal(back.joints, motion.joints)
    np.testing.assert_array_equal(back.features, motion.features)
    assert (back.text, back.skeleton, back.fps, back.seed) == (motion.text, "humanml3d", 20.0, seed)


def test_npy_round_trip(motion, tmp_path):
    double = replace(motion, joints=motion.joints.astype(np.float64))
    back = load_npy(export.save(double, tmp_path / "m.npy"))
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, motion.joints)


@pytest.mark.parametrize("suffix", [".html", ".npy", ".npz", ".png"])
def test_same_motion_gives_the_same_bytes(motion, tmp_path, suffix):
    if suffix == ".png":
        pytest.importorskip("matplotlib", reason="pip install 'kinema[viz]'")
    files = [export.save(motion, tmp_path / f"{name}{suffix}").read_bytes() for name in "ab"]
    assert files[0] == files[1]


@pytest.mark.parametrize("skeleton", [HUMANML3D, KIT], ids=lambda s: s.name)
def test_mp4_has_the_frames_and_rate(wander, tmp_path, skeleton):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="pip install 'kinema[viz]'")
    motion = Motion(wander(skeleton, 6), np.zeros((6, 1)), "a person turns", skeleton.name, skeleton.fps)
    path = export.save(motion, tmp_path / "film.mp4")
    reader = ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(480, 480, 3) for frame in reader]
    assert len(frames) == 6
    assert meta["fps"] == skeleton.fps
    for channel in (0, 2):  # an orange and a blue side
        other = 2 - channel
        assert (frames[0][..., channel].astype(int) - frames[0][..., other] > 80).sum() > 100


FULL = """
import resource, sys
import numpy as np
from kinema.motion import export
from kinema.motion.formats.arrays import load_npz
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
export.save(load_npz(sys.argv[1] + "/m.npz"), sys.argv[1] + "/film.mp4")
"""


@pytest.mark.parametrize("most", [0, 2000])
def test_a_film_that_finds_no_room_is_an_error_and_leaves_nothing(motion, tmp_path, most):
    """A disk that is full at once, and one that is full in the middle: the system refuses files above a size."""
    pytest.importorskip("imageio_ffmpeg", reason="pip install 'kinema[viz]'")
    export.save(motion, tmp_path / "m.npz")
    (tmp_path / "film.mp4").write_bytes(b"an older film")
    ended = subprocess.run([sys.executable, "-c", FULL, tmp_path, str(most)], capture_output=True, text=True)
    assert ended.returncode != 0
    assert f"OSError: could not write {tmp_path}/film.mp4: " in ended.stderr, ended.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "m.npz"]
    assert (tmp_path / "film.mp4").read_bytes() == b"an older film"


TITLES = ("pays $x^{2 and $5", r"$\frac{$", "a_b^c %s {0} <b>", "d\udce9marre", "\ud83c", "a\0b\n\tc", "", "x" * 500)


@pytest.mark.parametrize("title", TITLES)
@pytest.mark.parametrize("suffix", [".png", ".html", ".npz", ".amass.npz", ".glb"])
def test_any_text_can_stand_in_a_title(motion, tmp_path, suffix, title):
    if suffix == ".png":
        pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'kinema[viz]'")
    assert export.save(replace(motion, text=title), tmp_path / f"m{suffix}").stat().st_size > 1000


@pytest.mark.parametrize("title", TITLES[:4])
def test_any_text_can_stand_in_a_film(motion, tmp_path, title):
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed: pip install 'kinema[viz]'")
    short = replace(motion, text=title, joints=motion.joints[:3], features=motion.features[:3])
    assert export.save(short, tmp_path / "film.mp4").stat().st_size > 500


def test_dollar_signs_are_drawn_and_not_read(motion, tmp_path):
    image = pytest.importorskip("matplotlib.image", reason="matplotlib is not installed: pip install 'kinema[viz]'")
    drawn = [
        image.imread(export.save(replace(motion, text=t), tmp_path / f"{i}.png")) for i, t in enumerate(("$a$", "a"))
    ]
    assert not np.array_equal(*drawn)


def test_strip_is_one_wide_picture(motion, tmp_path):
    image = pytest.importorskip("matplotlib.image", reason="pip install 'kinema[viz]'")
    height, width, _ = image.imread(export.save(motion, tmp_path / "strip.png")).shape
    assert height == 500
    assert width > 2 * height


def test_a_strip_shows_travel(motion, tmp_path):
    image = pytest.importorskip("matplotlib.image", reason="pip install 'kinema[viz]'")
    here = np.repeat(motion.joints[:1], 12, axis=0)
    away = here + np.linspace(0, 3, 12, dtype=np.float32)[:, None, None] * np.array([0, 0, 1], np.float32)
    pictures = [
        image.imread(export.save(replace(motion, joints=joints), tmp_path / f"{i}.png"))
        for i, joints in enumerate((here, away))
    ]
    still, moving = (picture.shape[1] for picture in pictures)
    assert moving > still * 1.1  # the way from above, at the right
    blue = (pictures[1][:, still:, 2] - pictures[1][:, still:, 0]) > 0.4
    assert np.ptp(np.nonzero(blue)[0]) > 3 * np.ptp(np.nonzero(blue)[1])  # it went straight ahead: up


def test_unknown_suffix_names_the_known(motion, tmp_path):
    with pytest.raises(ValueError, match=r"'m\.gif'.*\.html, \.mp4, \.png, \.npy, \.npz"):
        export.save(motion, tmp_path / "m.gif")


@pytest.mark.parametrize("suffix", export.FORMATS)
def test_a_skeleton_that_a_format_cannot_hold_is_told_without_a_motion(suffix, wander, tmp_path, monkeypatch):
    monkeypatch.setattr("kinema.motion.formats.fbx.subprocess.run", None)  # no Blender is started for what can't be
    if suffix not in export.RIGGED:
        export.check(f"m{suffix}", KIT)
        return
    motion = Motion(wander(KIT, 6), np.zeros((6, 1)), "a person turns", "kit", KIT.fps)
    said = rf"^m{suffix}: there is no T-pose of kit; .* for humanml3d; write one of \.html"
    for refuse in (lambda: export.check(f"m{suffix}", KIT), lambda: export.save(motion, tmp_path / f"m{suffix}")):
        with pytest.raises(ValueError, match=said):
            refuse()


@pytest.mark.parametrize(
    ("suffix", "missing", "fix"),
    [(".mp4", "imageio_ffmpeg", "imageio-ffmpeg"), (".mp4", "matplotlib", "mat"), (".png", "matplotlib", "mat")],
)
def test_missing_libraries_are_told_without_a_motion(suffix, missing, fix, monkeypatch):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError, match=rf"needs {fix}.*pip install 'kinema\[viz\]'"):
        export.check(f"m{suffix}", HUMANML3D)


@pytest.mark.parametrize("suffix", [".mp4", ".png"])
def test_broken_motion_leaves_no_file(motion, tmp_path, suffix):
    joints = motion.joints.copy()
    joints[4, 0, 0] = np.inf
    with pytest.raises(ValueError, match="not finite from frame 4"):
        export.save(replace(motion, joints=joints), tmp_path / f"m{suffix}")
    assert not list(tmp_path.iterdir())


def test_interrupted_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")

    def interrupted() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]
    assert path.read_text() == "old"


def test_untrusted_files_are_refused(motion, tmp_path):
    class Bomb:
        def __reduce__(self):
            return (exec, ("raise SystemExit('executed')",))

    (tmp_path / "raw.npy").write_bytes(pickle.dumps(Bomb()))
    np.save(tmp_path / "object.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "object.npz", joints=np.array([Bomb()], dtype=object))
    for name in ("raw.npy", "object.npy"):
        with pytest.raises(ValueError, match=name):
            load_npy(tmp_path / name)
    with pytest.raises(ValueError, match=r"object\.npz"):
        load_npz(tmp_path / "object.npz")


def test_wrong_content_is_named(motion, tmp_path):
    np.save(tmp_path / "flat.npy", np.zeros((5, 66)))
    with pytest.raises(ValueError, match=r"\(frames, joints, 3\); it holds float64 \(5, 66\)"):
        load_npy(tmp_path / "flat.npy")
    np.savez(tmp_path / "part.npz", joints=motion.joints)
    with pytest.raises(ValueError, match="holds no features, text, fps, skeleton"):
        load_npz(tmp_path / "part.npz")
    with pytest.raises(FileNotFoundError, match=r"gone\.npy"):
        load_npy(tmp_path / "gone.npy")
