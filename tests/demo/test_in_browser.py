"""Drive `kinema demo` as a visitor does, in headless Chromium: generate, regenerate a range, save a file."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest
from tests.browser.conftest import PATIENCE
from tests.conftest import ROOT

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
def serve(tmp_path):
    """Start a process that serves a page, as a call that returns its address; its files are in the test's folder."""
    started = []

    def start(*words: str, **variables: str) -> str:
        (tmp_path / "tmp").mkdir()
        environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "OMP_NUM_THREADS": "1", **variables}
        process = subprocess.Popen(
            [sys.executable, *words],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # shells ignore it in the background
        )
        started.append(process)
        line = process.stdout.readline()
        found = re.fullmatch(r"open (http://\S+:\d+/) \(Ctrl\+C ends it\)\n", line)
        assert found, line + (process.stderr.read() if not line else "")
        return found[1]

    yield start
    (process,) = started
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode in (130, -signal.SIGINT)  # of the command, of a script
    left = [file.name for file in (tmp_path / "tmp").iterdir()]
    assert all(name.startswith("torchinductor") for name in left), left  # a folder that torch makes


@pytest.fixture
def server(serve, run) -> str:
    address = serve("-m", "kinema.cli", "demo", "--run", str(run), "--device", "cpu")
    assert address.startswith("http://127.0.0.1:")
    return address


@pytest.fixture
def visitor(chromium):
    """Return the browser, and leave the page afterwards: its players would go on playing."""
    yield chromium
    chromium.visit("about:blank")


def write(visitor, field, text):
    visitor.js(
        f"(() => {{ const field = document.querySelector('{field} textarea, {field} input'); field.value = {text!r};"
        " field.dispatchEvent(new Event('input', { bubbles: true })); })()"
    )


def press(visitor, button):
    visitor.js(f"document.querySelector('#{button}').click()")


def test_a_visitor_generates_regenerates_and_saves(visitor, server, tmp_path):
    visitor.visit(server)
    visitor.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    visitor.until("document.querySelector('#demo-generate')")
    write(visitor, "#demo-text", "a person <b>walks</b>")
    press(visitor, "demo-generate")
    visitor.until(FRAMES)
    assert visitor.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 2
    assert visitor.js(f"{FRAMES}.srcdoc.includes('a person &lt;b&gt;walks')")
    visitor.until(f"parseInt({FRAMES}.style.height) > 300")  # the players tell how high they are, so they run

    visitor.js(DRAG)
    write(visitor, "#demo-change", "a person jumps")
    press(visitor, "demo-regenerate")
    label = "3 (2 with 0.4 to 1.2 s new)"
    visitor.until(f"document.querySelector('#demo-which').innerText.includes('{label}')")
    assert visitor.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 3

    press(visitor, "demo-save-npz")
    file = tmp_path / "a-person-jumps-3.npz"
    end = time.monotonic() + PATIENCE
    while not file.exists() and time.monotonic() < end:
        time.sleep(0.05)
    saved = load_npz(file)
    assert saved.text == "a person jumps"
    assert [int(i) for i in (~saved.kept).nonzero()[0]] == list(range(8, 24))

    write(visitor, "#demo-text", " ")
    press(visitor, "demo-generate")
    visitor.until("document.querySelector('[role=alert]')?.innerText.startsWith('text 0 is empty')")
    assert visitor.js(f"{FRAMES}.srcdoc.split('<figure ').length - 1") == 3  # what was there stays

    assert visitor.complaints == []
    assert all(url.startswith((server, "data:", "blob:", "about:")) for url in visitor.asked), visitor.asked


@pytest.mark.parametrize("dark", [False, True])
def test_it_fits_a_telephone(visitor, server, dark):
    visitor.visit(server, width=400, dark=dark)
    visitor.until("document.querySelector('#demo-generate')")
    press(visitor, "demo-generate")
    visitor.until(FRAMES)
    visitor.until("document.querySelector('#demo-regenerate')")
    assert visitor.js("document.documentElement.scrollWidth") <= 400
    assert visitor.js(f"getComputedStyle({FRAMES}).colorScheme") == ("dark" if dark else "light")


def test_the_app_of_a_space_serves_where_it_is_told_to(serve, tmp_path):
    """Run app.py as docs/demo.md has it, with a Space's variable."""
    (app,) = re.findall(r"^```py\n(.*?)^```", (ROOT / "docs" / "demo.md").read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "app.py").write_text(app)
    path = os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])
    address = serve("app.py", GRADIO_SERVER_NAME="0.0.0.0", PYTHONPATH=path)
    assert re.fullmatch(r"http://0\.0\.0\.0:\d+/|http://localhost:\d+/", address)
    with urllib.request.urlopen(address.replace("0.0.0.0", "127.0.0.1")) as answer:
        assert "Kinema · text to motion" in answer.read().decode()


def test_a_page_elsewhere_is_not_answered(server):
    """Refuse a foreign name that was made to lead to this machine."""
    asked = urllib.request.Request(f"{server}config", headers={"Host": "elsewhere.example"})
    with pytest.raises(urllib.error.HTTPError, match="400"):
        urllib.request.urlopen(asked)
    with urllib.request.urlopen(f"{server}config") as answer:
        assert answer.status == 200
