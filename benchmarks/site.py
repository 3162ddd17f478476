"""Measure how long a report's page of many motions takes to open, in headless Chromium and from file://.

    python benchmarks/site.py                             # 50 rows of 6 motions of 120 frames, in a temporary folder
    python benchmarks/site.py --page reports/gallery.html # a page that is there

Seconds from the start of navigation until the page is loaded, and until the first motion in view is drawn (the page is
scrolled to its motions at once); the median over `--repeats`, each with an empty cache of its own.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np

from kinema.motion.skeleton import HUMANML3D
from kinema.report.site import render
from kinema.types import Motion

DRIVER = Path(__file__).resolve().parents[1] / "tests" / "browser" / "conftest.py"
FIRST = "document.querySelector('.kinema-prompts .kinema-player, .kinema-player')"
DRAWN = f"""new Promise((done) => {{
  {FIRST}.scrollIntoView();
  const look = () => {FIRST}.kinema.tracks && {FIRST}.querySelector('canvas').width
    ? done(performance.now()) : requestAnimationFrame(look);
  look();
}})"""
LOADED = "performance.getEntriesByType('navigation')[0].loadEventEnd"


def make_page(folder: Path, rows: int, prompts: int, frames: int) -> Path:
    """Write a table of rows that have motions of their own."""
    rng = np.random.default_rng(0)
    names = [f"method {i}" for i in range(rows)]

    def motion(prompt: int) -> Motion:
        joints = rng.normal(scale=0.02, size=(frames, 22, 3)).cumsum(axis=0).astype(np.float32)
        return Motion(joints, np.zeros((frames, 0), np.float32), f"prompt {prompt}", HUMANML3D.name, HUMANML3D.fps)

    table = {
        "name": "many",
        "title": "Many motions",
        "columns": [{"key": "fid", "label": "FID", "better": "lower"}],
        "rows": [{"key": n, "label": n, "kind": "method", "results": [{"fid": float(i)}]} for i, n in enumerate(names)],
    }
    render(table, folder, {name: [motion(prompt) for prompt in range(prompts)] for name in names})
    return folder / "index.html"


def main() -> None:
    """Print the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", type=Path, help="page to open (default: one that is made)")
    parser.add_argument("--rows", type=int, default=50)
    parser.add_argument("--prompts", type=int, default=6)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    binary = shutil.which("chromium") or shutil.which("google-chrome")
    if binary is None:
        sys.exit("error: no Chromium on this machine")
    spec = importlib.util.spec_from_file_location("driver", DRIVER)
    driver = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(driver)
    with tempfile.TemporaryDirectory() as folder:
        page = options.page or make_page(Path(folder), options.rows, options.prompts, options.frames)
        found = []
        for i in range(options.repeats):
            browser = driver.Browser(binary, Path(folder) / f"profile{i}")
            browser.open(page)
            drawn, loaded = browser.js(DRAWN), browser.js(LOADED)
            found.append((loaded / 1000, drawn / 1000, browser.js("kinema.players.size")))
            browser.close()
    loaded, drawn = (statistics.median(column) for column in list(zip(*found, strict=True))[:2])
    print(f"{page}: {found[0][2]} players, loaded after {loaded:.2f} s, first motion drawn after {drawn:.2f} s")


if __name__ == "__main__":
    main()
