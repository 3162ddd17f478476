"""Drive `kinema demo` as a visitor does, in headless Chromium: generate, regenerate a range, save a file."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from tests.browser.conftest import PATIENCE

from kinema.motion.export import load_npz

pytest.importorskip("gradio", reason="the demo needs gradio: make test-demo")
pytestmark = pytest.mark.slow

FRAMES = "document.querySelector('#demo-players iframe')"
DRAG = """(() => [[0, 8], [1, 24]].forEach(([i, frame]) => {
  const thumb = document.querySelectorAll('#demo-timeline input')[i];
  thumb.value = frame;
  thumb.dispatchEvent(new Event('input', { bubbles: true }));
}))()"""


@pytest.fixture
def server(run, tmp_path):
    """Serve the page of a tiny model on a free port; its files are in a folder of the test's own."""
    (tmp_path / "tmp").mkdir()
    command = [sys.executable, "-m", "kinema.cli", "demo", "--run", str(run), "--device", "cpu"]
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    line = process.stdout.readline()
    found = re.fullmatch(r"open (http://127\.0\.0\.1:\d+/) \(Ctrl\+C ends it\)\n", line)
    assert found, line + (process.stderr.read() if not line else "")
    yield found[1]
    process.send_signal(signal.SIGINT)
    _, complaints = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "Traceback" not in complaints
    left = [file.name for file in (tmp_path / "tmp").iterdir()]
    assert all(name.startswith("torchinductor") for name in left), left  # a folder that torch makes


def write(chromium, field, text):
    chromium.js(
        f"(() => {{ const field = document.querySelector('{field} textarea, {field} input'); field.value = {text!r};"
        " field.dispatchEvent(new Event('input', { bubbles: true })); })()"
    )


def press(chromium, button):
    chromium.js(f"document.querySelector('#{button}').click()")


def test_a_visitor_generates_regenerates_and_saves(chromium, server, tmp_path):
    chromium.visit(server)
    chromium.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    chromium.until("document.querySelector('#demo-generate')")
    write(chromium, "#demo-text", "a person <b>walks</b>")
    press(chromium, "demo-generate")
    chromium.until(FRAMES)
    assert chromium.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 2
    assert chromium.js(f"{FRAMES}.srcdoc.includes('a person &lt;b&gt;walks')")
    chromium.until(f"parseInt({FRAMES}.style.height) > 300")  # the players tell how high they are, so they run

    chromium.js(DRAG)
    write(chromium, "#demo-change", "a person jumps")
    press(chromium, "demo-regenerate")
    label = "3 (2 with 0.4 to 1.2 s new)"
    chromium.until(f"document.querySelector('#demo-which').innerText.includes('{label}')")
    assert chromium.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 3

    press(chromium, "demo-save-npz")
    file = tmp_path / "a-person-jumps-3.npz"
    end = time.monotonic() + PATIENCE
    while not file.exists() and time.monotonic() < end:
        time.sleep(0.05)
    saved = load_npz(file)
    assert saved.text == "a person jumps"
    assert [int(i) for i in (~saved.kept).nonzero()[0]] == list(range(8, 24))

    write(chromium, "#demo-text", " ")
    press(chromium, "demo-generate")
    chromium.until("document.querySelector('[role=alert]')?.innerText.startsWith('text 0 is empty')")
    assert chromium.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 3  # what was there stays

    assert chromium.complaints == []
    assert all(url.startswith((server, "data:", "blob:", "about:")) for url in chromium.asked), chromium.asked


@pytest.mark.parametrize("dark", [False, True])
def test_it_fits_a_telephone(chromium, server, dark):
    chromium.visit(server, width=400, dark=dark)
    chromium.until("document.querySelector('#demo-generate')")
    press(chromium, "demo-generate")
    chromium.until(FRAMES)
    chromium.until("document.querySelector('#demo-regenerate')")
    assert chromium.js("document.documentElement.scrollWidth") <= 400
    assert chromium.js(f"getComputedStyle({FRAMES}).colorScheme") == ("dark" if dark else "light")
