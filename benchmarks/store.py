"""Measure a packed store of HumanML3D's size: preparing, opening, serving, and the memory that is a process' own.

    python benchmarks/store.py                          # 30,000 clips, 4 million frames: 4.2 GB in a temporary folder
    python benchmarks/store.py --clips 300 --folder /x  # smaller, elsewhere

Opening and serving run in a fresh process each. The baseline is what data sets commonly do: `np.load` every clip's
file and keep the arrays in a list; it runs on fewer clips (--baseline-clips), since its memory grows with them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

FRAMES = 133
"""Mean frames of a clip: 30,000 of them make 4 million."""


def private_megabytes() -> float:
    """Read the memory that is this process' own (Linux): anonymous pages.

    Pages of a mapped file are the page cache's, and every process that maps the file shares them.
    """
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Anonymous:")) / 1024


def measure(work) -> dict[str, float]:
    """Run something in this process; give its seconds and the private memory it adds."""
    before, start = private_megabytes(), time.perf_counter()
    kept = work()
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "private MB": private_megabytes() - before, "kept": len(kept)}


def open_store(path: Path) -> list:
    """Open a store, and read one entry."""
    from kinema.data.store import PackedStore

    def work() -> list:
        store = PackedStore.open(path)
        return [store, store.frames_of(0).sum(), store.entry_captions(0)]

    return [measure(work)]


def serve(path: Path) -> list:
    """Open a store and serve 200 batches of 64: windows, then captioned clips."""
    from kinema.data.collate import collate
    from kinema.data.datasets import ClipDataset, WindowDataset
    from kinema.data.sampler import StepSampler
    from kinema.data.store import PackedStore

    def work(make) -> list:
        data = make(PackedStore.open(path), "train")
        for batch in StepSampler(len(data), min(64, len(data)), seed=0, steps=200):
            collate([data[item] for item in batch])
        return [data]

    return [measure(partial(work, make)) for make in (WindowDataset, ClipDataset)]


def load_files(folder: Path) -> list:
    """Load every file into a list, the baseline."""
    return [measure(lambda: [np.load(file) for file in sorted(folder.glob("*.npy"))])]


def fresh(task: str, path: Path) -> list[dict[str, float]]:
    """Run a task in a process of its own."""
    run = subprocess.run(
        [sys.executable, __file__, "--task", task, "--path", str(path)], capture_output=True, text=True
    )
    if run.returncode:
        raise RuntimeError(run.stderr)
    return json.loads(run.stdout)


def noise(block: np.ndarray, index: int) -> np.ndarray:
    """Cut a clip's features out of a block of noise."""
    draw = np.random.default_rng(index)
    frames = int(draw.integers(FRAMES - 66, FRAMES + 66))
    start = int(draw.integers(len(block) - frames))
    return block[start : start + frames]


def run(folder: Path, clips: int, baseline_clips: int) -> None:
    """Build, measure and print."""
    from kinema.data.captions import parse_captions
    from kinema.data.catalog import Clip
    from kinema.data.prepare import prepare
    from kinema.data.store import PackedStore

    block = np.random.default_rng(0).standard_normal((1 << 14, 263), dtype=np.float32)
    texts = "a person walks {0}#a/DET person/NOUN walk/VERB#0#0\nclip number {0}#clip/NOUN number/NOUN#0#0"
    corpus = [
        Clip(f"{i:06d}", "train", parse_captions(texts.format(i)), features=partial(noise, block, i))
        for i in range(clips)
    ]
    start = time.perf_counter()
    store = PackedStore.open(prepare(corpus, folder / "store", name="noise", mirror=False))
    gigabytes = store.features.nbytes / 1e9
    print(f"{clips} clips, {len(store.features)} frames, {gigabytes:.2f} GB")
    print(f"{'prepare':32} {time.perf_counter() - start:8.2f} s")
    files = folder / "files"
    files.mkdir()
    for i in range(baseline_clips):
        np.save(files / f"{i:06d}.npy", store.clip_frames(i))
    results = {"open and read one entry": fresh("open", store.path)[0]}
    served = fresh("serve", store.path)
    results |= {"200 batches of 64 windows": served[0], "200 batches of 64 clips": served[1]}
    loaded = fresh("files", files)[0]
    results[f"baseline: load {baseline_clips} files"] = loaded
    scale = {key: loaded[key] * clips / baseline_clips for key in ("seconds", "private MB")}
    results[f"   scaled to {clips}"] = scale
    for name, found in results.items():
        print(f"{name:32} {found['seconds']:8.3f} s {found['private MB']:10.1f} MB private")
    opened, own = results["open and read one entry"], max(s["private MB"] for s in served)
    print(f"ratio {scale['seconds'] / opened['seconds']:.0f} in seconds to the first entry")
    print(f"ratio {scale['private MB'] / max(own, 1):.0f} in private memory while serving")


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=30_000)
    parser.add_argument("--baseline-clips", type=int, default=3_000)
    parser.add_argument("--folder", type=Path, help="where the temporary folder is made")
    parser.add_argument("--task", choices=("open", "serve", "files"), help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.task:
        task = {"open": open_store, "serve": serve, "files": load_files}[arguments.task]
        print(json.dumps(task(arguments.path)))
        return
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        run(Path(folder), arguments.clips, min(arguments.baseline_clips, arguments.clips))


if __name__ == "__main__":
    main()
