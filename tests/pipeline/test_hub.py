"""A model goes to a hub and comes back from it, and from the cache when it is gone: a server of our own stands in."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import ClassVar

import pytest

from kinema.pipeline.card import Card

REPOSITORY = "somebody/walker"
CARD = Card("walker", "MARDM-SiT", "a corpus", "22 joints", "hashed-64", {"generator": 1}, half=True)
COMMIT = "c" * 40


class Hub(BaseHTTPRequestHandler):
    """Answer what huggingface_hub asks to make a repository, commit small files, list and read them."""

    files: ClassVar[dict[str, bytes]] = {}
    asked: ClassVar[list[str]] = []

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.asked.append(f"POST {self.path}")
        if self.path == "/api/validate-yaml":  # the head of the card
            self.answer({"errors": [], "warnings": []})
        elif self.path == "/api/repos/create":
            self.answer({"url": f"http://{self.headers['Host']}/{REPOSITORY}"})
        elif "/preupload/" in self.path:
            names = [file["path"] for file in json.loads(body)["files"]]
            self.answer({"files": [{"path": n, "uploadMode": "regular", "shouldIgnore": False} for n in names]})
        elif "/commit/" in self.path:
            lines = [json.loads(line) for line in body.splitlines()]
            found = [line["value"] for line in lines if line["key"] == "file"]
            self.files.update({file["path"]: base64.b64decode(file["content"]) for file in found})
            self.answer(
                {"commitUrl": f"http://{self.headers['Host']}/{REPOSITORY}/commit/{COMMIT}", "commitOid": COMMIT}
            )
        else:
            self.answer({}, 404)

    def do_GET(self) -> None:
        self.asked.append(f"{self.command} {self.path}")
        place, _, file = self.path.partition("/resolve/")
        content = self.files.get(file.partition("/")[2])
        if content is not None and place == f"/{REPOSITORY}":
            digest = hashlib.sha1(content).hexdigest()
            self.answer(content, 200, {"ETag": f'"{digest}"', "X-Repo-Commit": COMMIT})
        elif self.path.split("?")[0].startswith(f"/api/models/{REPOSITORY}/tree/"):
            rows = [{"type": "file", "path": n, "size": len(c), "oid": "0"} for n, c in self.files.items()]
            self.answer(rows)
        elif self.path.split("?")[0].startswith(f"/api/models/{REPOSITORY}"):
            names = [{"rfilename": name} for name in self.files]
            self.answer({"id": REPOSITORY, "sha": COMMIT, "siblings": names, "private": False, "tags": []})
        else:
            self.answer({"error": "Repository not found"}, 404, {"X-Error-Code": "RepoNotFound"})

    do_HEAD = do_GET  # noqa: N815

    def answer(self, content: object, code: int = 200, headers: dict[str, str] | None = None) -> None:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(code)
        for name, value in {"Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def hub() -> Iterator[ThreadingHTTPServer]:
    Hub.files, Hub.asked = {}, []
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


SCRIPT = """
import sys
from kinema import TextToMotion, cli

task, folder = sys.argv[1:]
if task == "push":
    print(TextToMotion.from_pretrained(folder, "cpu").push_to_hub("somebody/walker"))
else:
    model = TextToMotion.from_pretrained("somebody/walker", "cpu")
    print(model.generate("a person walks", 16, seed=3)[0].joints.sum())
    assert cli.main(["models"]) == 0
"""


@pytest.mark.slow
def test_a_model_goes_to_the_hub_and_comes_back_also_without_it(model, hub, tmp_path):
    model.card = CARD
    packed = model.save(tmp_path / "walker", half=True)
    (packed / "notes.txt").write_text("not a file of the model")
    address = f"http://127.0.0.1:{hub.server_address[1]}"
    environment = {**os.environ, "HF_ENDPOINT": address, "HF_HOME": str(tmp_path / "home"), "HF_TOKEN": "hf_none"}
    environment |= {"HF_HUB_DISABLE_XET": "1", "HF_HUB_DISABLE_TELEMETRY": "1", "HF_HUB_DISABLE_PROGRESS_BARS": "1"}
    environment |= {"HF_HUB_DISABLE_UPDATE_CHECK": "1", "no_proxy": "127.0.0.1"}
    for name in ("HF_HUB_CACHE", "HF_HUB_OFFLINE"):
        environment.pop(name, None)

    def told(task: str) -> str:
        command = [sys.executable, "-c", SCRIPT, task, str(packed)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert done.returncode == 0, f"{done.stderr}\n{Hub.asked}"
        return done.stdout

    assert told("push").strip() == f"{address}/{REPOSITORY}/commit/{COMMIT}"
    whole = {p.relative_to(packed).as_posix() for p in packed.rglob("*") if p.is_file()}
    assert Hub.files.keys() == whole - {"notes.txt"}
    assert Hub.files["weights.safetensors"] == (packed / "weights.safetensors").read_bytes()
    Hub.files["training.ckpt"] = b"what nobody asked for"
    first = told("pull")
    assert not any("training.ckpt" in asked for asked in Hub.asked if "/resolve/" in asked)
    assert "somebody/walker" in first
    assert "hub cache" in first
    hub.shutdown()
    hub.server_close()
    assert told("pull") == first  # from the cache


def test_what_the_hub_does_not_have_or_is_no_model_is_one_line(model, hub, tmp_path, monkeypatch):
    from kinema.pipeline import TextToMotion

    def answer(error):
        def download(*_, **__):
            if isinstance(error, Exception):
                raise error
            return error

        monkeypatch.setattr("huggingface_hub.snapshot_download", download)

    answer(OSError("401 Client Error\nmore lines"))
    with pytest.raises(FileNotFoundError, match=r"gone is no folder, no model .* did not give it: 401 Client Error$"):
        TextToMotion.from_pretrained("somebody/gone")
    (tmp_path / "other").mkdir()
    answer(str(tmp_path / "other"))
    with pytest.raises(ValueError, match=r"is no model that `kinema pack` made: it has no card\.json"):
        TextToMotion.from_pretrained("somebody/other")
