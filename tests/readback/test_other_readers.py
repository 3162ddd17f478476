"""What others' software reads from exports is the motion: within a millimetre, at every tenth frame."""

from __future__ import annotations

import base64
import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.motion.rig.test_amass import PARENTS, posed
from tests.readback.conftest import MOST, MOTIONS, NAMES, STRIDE

from kinema.motion import export
from kinema.motion.rig.changes import Changes

HERE = Path(__file__).parent
BUNDLE = HERE / "node_modules" / "readers.js"
BY_BLENDER = (".bvh", ".glb", ".vrma", ".fbx")
UNITS = {".bvh": 100, ".fbx": 100, ".glb": 1, ".vrma": 1}
"""Units of a format's lengths in a metre."""
VERTICES, HANDS = 6890, {"components": (45, 45), "mean": (45,)}
"""Of SMPL-H's model file."""


def joints(frames: list[dict[str, list[float]]]) -> np.ndarray:
    """Order places that were read by name."""
    return np.array([[frame[name] for name in NAMES] for frame in frames])


@pytest.mark.parametrize("motion", MOTIONS)
def test_bvhio_reads_bvh(motion, written, agree):
    bvhio = pytest.importorskip("bvhio", reason="pip install bvhio")
    root = bvhio.readAsHierarchy(str(written(motion, ".bvh")))
    found = []
    for frame in range(0, root.getKeyframeRange()[1] + 1, STRIDE):
        root.loadPose(frame)
        found.append({joint.Name: list(joint.PositionWorld) for joint, _, _ in root.layout()})
    agree(".bvh", "bvhio", motion, joints(found) / UNITS[".bvh"])


@pytest.mark.parametrize("motion", MOTIONS)
def test_plain_scipy_reads_amass(motion, written, agree):
    with np.load(written(motion, ".amass.npz")) as file:
        x, y, z = np.moveaxis(posed(file["rest_joints"], file["poses"], file["trans"])[::STRIDE], -1, 0)
    agree(".amass.npz", "NumPy and SciPy", motion, np.stack([x, z, -y], -1))


def body_model(rest: np.ndarray, folder: Path) -> None:
    """Make up a body of SMPL-H whose joints rest here; what else it holds is zero."""
    regressor = np.zeros((52, VERTICES))
    regressor[np.arange(52), np.arange(52)] = 1
    template = np.zeros((VERTICES, 3))
    template[:22] = rest
    np.savez(
        folder / "SMPLH_NEUTRAL.npz",
        v_template=template,
        shapedirs=np.zeros((VERTICES, 3, 16)),
        posedirs=np.zeros((VERTICES, 3, 51 * 9)),
        J_regressor=regressor,
        kintree_table=np.array([[*PARENTS, *[20] * 15, *[21] * 15], range(52)]),
        weights=np.eye(VERTICES, 52),
        f=np.zeros((1, 3), dtype=np.int64),
        **{f"hands_{what}{side}": np.zeros(shape) for what, shape in HANDS.items() for side in "lr"},
    )


@pytest.mark.parametrize("motion", MOTIONS)
def test_smplx_reads_amass(motion, written, agree, tmp_path):
    """As docs/export.md does it, with a body of the motion's own bones."""
    smplx = pytest.importorskip("smplx", reason="pip install smplx (not free for commercial use)")
    with np.load(written(motion, ".amass.npz")) as file:
        body_model(file["rest_joints"], tmp_path)
        poses, trans = (torch.tensor(file[name][::STRIDE], dtype=torch.float64) for name in ("poses", "trans"))
    options = {"ext": "npz", "use_pca": False, "flat_hand_mean": True, "batch_size": len(poses)}
    body = smplx.SMPLH(str(tmp_path / "SMPLH_NEUTRAL.npz"), dtype=torch.float64, **options)
    posed = body(
        global_orient=poses[:, :3],
        body_pose=poses[:, 3:66],
        left_hand_pose=poses[:, 66:111],
        right_hand_pose=poses[:, 111:],
        transl=trans,
    )
    x, y, z = np.moveaxis(posed.joints[:, :22].detach().numpy(), -1, 0)
    agree(".amass.npz", "smplx", motion, np.stack([x, z, -y], -1))


@pytest.fixture(scope="module")
def page(chromium, tmp_path_factory):
    """Open a page with the readers of `make readers`, or skip."""
    if not BUNDLE.is_file():
        pytest.skip("three.js and gltf-validator aren't here: make readers (npm)")
    path = tmp_path_factory.mktemp("page") / "readers.html"
    path.write_text(f"<!doctype html><meta charset=utf-8><script>{BUNDLE.read_text()}</script>")
    chromium.open(path)
    return chromium


def packed(path: Path) -> str:
    return json.dumps(base64.b64encode(path.read_bytes()).decode())


@pytest.mark.parametrize("ending", UNITS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_three_reads_it(motion, ending, written, agree, motions, page, request):
    if ending == ".fbx":
        request.getfixturevalue("blender")
    fps = motions[motion].fps
    times = [frame / fps for frame in range(0, len(motions[motion].joints), STRIDE)]
    frames = page.js(f"readers.positions('{ending[1:]}', {packed(written(motion, ending))}, {times})")
    agree(ending, "three.js", motion, joints(frames) / UNITS[ending])


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_vrm_model_of_these_bones_moves_as_the_motion_does(motion, written, agree, motions, page):
    times = [frame / motions[motion].fps for frame in range(0, len(motions[motion].joints), STRIDE)]
    frames = page.js(f"readers.drive({packed(written(motion, '.vrma'))}, {times})")
    agree(".vrma", "three-vrm", motion, joints(frames))


@pytest.mark.parametrize("fps", [30, 12.5])
def test_blender_keeps_the_rate_of_fbx(fps, motions, blender, page, tmp_path):
    """Blender counts frames of its own clock: they are where the file's times say."""
    motion, changes = motions["jumping"], Changes(fps=fps)
    path = export.save(motion, tmp_path / "a.fbx", changes)
    expected = changes.apply(export.RIGGED[".fbx"].fit(motion)).positions[::STRIDE]
    times = (np.arange(len(expected)) * STRIDE / fps).tolist()
    found = joints(page.js(f"readers.positions('fbx', {packed(path)}, {times})")) / UNITS[".fbx"]
    assert np.linalg.norm(found - expected, axis=-1).max() < MOST / 1000


def test_blender_takes_half_a_character_for_a_title(motions, blender, tmp_path):
    motion = replace(motions["jumping"], text="d\udce9marre")
    assert export.save(motion, tmp_path / "a.fbx").stat().st_size > 10_000


@pytest.mark.parametrize("ending", [".glb", ".vrma"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_khronos_validator_finds_nothing(motion, ending, written, page):
    assert page.js(f"readers.complaints({packed(written(motion, ending))})") == []


def test_the_validator_finds_what_is_wrong(written, page, tmp_path):
    content = written("walking", ".glb").read_bytes()
    (tmp_path / "bad.glb").write_bytes(content.replace(b'"VEC4"', b'"VEC3"', 1))
    assert page.js(f"readers.complaints({packed(tmp_path / 'bad.glb')})")


@pytest.fixture(scope="module")
def by_blender(blender, written, motions, tmp_path_factory):
    """Read every file in one process."""
    target = tmp_path_factory.mktemp("blender") / "read.json"
    files = [written(motion, ending) for motion in MOTIONS for ending in BY_BLENDER]
    fps = motions["walking"].fps
    command = [blender, HERE / "in_blender.py", target, str(fps), str(STRIDE), *files]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(target.read_text())


@pytest.mark.parametrize("ending", BY_BLENDER)
@pytest.mark.parametrize("motion", MOTIONS)
def test_blender_reads_it(motion, ending, by_blender, agree):
    agree(ending, "Blender", motion, joints(by_blender[f"{motion}{ending}"]))
