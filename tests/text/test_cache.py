from __future__ import annotations

import os
import pickle
import subprocess
import sys

import pytest
import torch

from kinema.text.cache import CachedTextEncoder
from kinema.text.hashed import HashedTextEncoder

TEXTS = ["a person walks", "someone jumps over a box", "wave", "a man sits down", "ein Männchen hüpft"]


class Counting(HashedTextEncoder):
    """Record what is really encoded."""

    def __init__(self, dim: int = 16) -> None:
        super().__init__(dim)
        self.seen: list[str] = []

    def __call__(self, texts):
        self.seen += texts
        return super().__call__(texts)


def assert_same(found, expected):
    assert found.texts == expected.texts
    torch.testing.assert_close(found.pooled, expected.pooled, atol=0, rtol=0)
    torch.testing.assert_close(found.tokens, expected.tokens, atol=0, rtol=0)
    assert torch.equal(found.token_mask, expected.token_mask)


def test_answers_like_the_encoder_in_any_order_and_encodes_each_text_once(tmp_path):
    encoder, plain = Counting(), HashedTextEncoder(16)
    cache = CachedTextEncoder(encoder, tmp_path, chunk=2)
    for order in (TEXTS, TEXTS[::-1], [TEXTS[2], TEXTS[0], TEXTS[2]]):
        assert_same(cache(order), plain(order))
    assert sorted(encoder.seen) == sorted(TEXTS)
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS[1:]), plain(TEXTS[1:]))
    assert (cache.encoded, again.encoded, again.encoder.seen) == (len(TEXTS), 0, [])


def test_results_are_the_callers_to_change(tmp_path):
    cache = CachedTextEncoder(Counting(), tmp_path)
    cache(TEXTS).pooled.zero_()
    assert_same(cache(TEXTS), HashedTextEncoder(16)(TEXTS))


def test_each_encoder_has_its_own_features(tmp_path):
    small, large = CachedTextEncoder(Counting(16), tmp_path), CachedTextEncoder(Counting(24), tmp_path)
    assert (small(TEXTS).pooled.shape[1], large(TEXTS).pooled.shape[1]) == (16, 24)
    assert large.encoded == len(TEXTS)
    assert small.folder != large.folder


def test_folder_of_another_encoder_is_refused(tmp_path):
    cache = CachedTextEncoder(Counting(16), tmp_path)
    cache(TEXTS)
    other = CachedTextEncoder(Counting(24), tmp_path)
    other.folder = cache.folder
    with pytest.raises(ValueError, match="delete the folder"):
        other(TEXTS)


@pytest.mark.parametrize("name", ["index.bin", "pooled.bin", "tokens.bin"])
@pytest.mark.parametrize("cut", [1, 70])
def test_a_torn_tail_is_dropped_and_written_anew(tmp_path, name, cut):
    expected = HashedTextEncoder(16)(TEXTS)
    first = CachedTextEncoder(Counting(), tmp_path, chunk=1)
    first(TEXTS)
    path = first.folder / name
    path.write_bytes(path.read_bytes()[:-cut])
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS), expected)
    assert 1 <= again.encoded < len(TEXTS)
    third = CachedTextEncoder(Counting(), tmp_path)
    assert_same(third(TEXTS), expected)
    assert third.encoded == 0


def test_data_without_a_record_and_a_damaged_record_are_overwritten(tmp_path):
    first = CachedTextEncoder(Counting(), tmp_path)
    first(TEXTS[:2])
    for name in ("pooled.bin", "tokens.bin"):
        with open(first.folder / name, "ab") as file:
            file.write(b"\x7f" * 99)  # killed after the data, before its record
    with open(first.folder / "index.bin", "ab") as file:
        file.write(b"\x05\x00\x00\x00\x01\x00\x00\x00\x00\x00\x00\x00hello")
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert sorted(again.encoder.seen) == sorted(TEXTS[2:])


def test_zeros_left_by_a_crash_are_no_records(tmp_path):
    first = CachedTextEncoder(Counting(), tmp_path)
    first(TEXTS[:2])
    for name in ("pooled.bin", "tokens.bin", "index.bin"):
        with open(first.folder / name, "ab") as file:
            file.write(bytes(4096))
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert again.encoded == len(TEXTS) - 2


def test_files_that_shrink_under_a_writer_are_not_patched_up(tmp_path):
    cache = CachedTextEncoder(Counting(), tmp_path)
    cache(TEXTS[:2])
    for name in ("pooled.bin", "tokens.bin", "index.bin"):
        (cache.folder / name).unlink()
    with pytest.raises(OSError, match="shrank while in use"):
        cache(TEXTS)


def test_sizes_that_a_network_file_system_still_remembers_cut_nothing_off(tmp_path, monkeypatch):
    first, second = CachedTextEncoder(Counting(), tmp_path, chunk=1), CachedTextEncoder(Counting(), tmp_path)
    first(TEXTS[:1])
    second(TEXTS[:1])
    known, stat = {name: os.stat(first.folder / name) for name in ("pooled.bin", "tokens.bin", "index.bin")}, os.stat
    first(TEXTS[1:4])

    def remembered(path, *args, **kwargs):
        name = os.path.basename(path) if isinstance(path, str | os.PathLike) else None
        return known.get(name) or stat(path, *args, **kwargs)

    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", remembered)
        assert (second.folder / "pooled.bin").stat().st_size < stat(second.folder / "pooled.bin").st_size
        assert_same(second(TEXTS), HashedTextEncoder(16)(TEXTS))
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert (second.encoded, again.encoded) == (1, 0)


def test_records_that_a_writer_has_not_seen_are_not_cut_off(tmp_path):
    blind, other = CachedTextEncoder(Counting(), tmp_path), CachedTextEncoder(Counting(), tmp_path)
    blind(TEXTS[:1])
    other(TEXTS)
    found = HashedTextEncoder(16)(TEXTS[1:2])
    with pytest.raises(OSError, match="records of another process that were not seen"):
        blind.features.append(TEXTS[1:2], found.pooled.numpy(), [found.tokens[0].numpy()])
    again = CachedTextEncoder(Counting(), tmp_path)
    assert_same(again(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert again.encoded == 0


def test_an_encoder_that_fails_leaves_nothing_behind(tmp_path):
    class Failing(Counting):
        def __call__(self, texts):
            found = super().__call__(texts)
            found.pooled[0] = float("nan")
            return found

    with pytest.raises(ValueError, match="not finite"):
        CachedTextEncoder(Failing(), tmp_path)(TEXTS)
    cache = CachedTextEncoder(Counting(), tmp_path)
    assert_same(cache(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert cache.encoded == len(TEXTS)


WORKER = """
import sys
from kinema.text.cache import CachedTextEncoder
from kinema.text.hashed import HashedTextEncoder
folder, step, *texts = sys.argv[1:]
cache = CachedTextEncoder(HashedTextEncoder(16), folder, chunk=int(step))
print("ready", flush=True)
sys.stdin.readline()
for start in range(0, len(texts), 8):
    cache(texts[start : start + 8])
    print(cache.encoded, flush=True)
"""
MANY = [f"{a} {b}{c}" for a in ("walk", "run", "jump", "sit") for b in "abcd" for c in "efgh"]


def start_worker(folder, step, texts):
    command = [sys.executable, "-c", WORKER, str(folder), str(step), *texts]
    worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert worker.stdout.readline() == "ready\n"
    return worker


def test_two_processes_share_the_work(tmp_path):
    workers = [start_worker(tmp_path, 3, texts) for texts in (MANY, MANY[::-1])]
    for worker in workers:
        worker.stdin.write("go\n")
        worker.stdin.flush()
    encoded = [int(worker.communicate()[0].split()[-1]) for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0]
    assert sum(encoded) == len(MANY)
    cache = CachedTextEncoder(Counting(), tmp_path)
    assert_same(cache(MANY), HashedTextEncoder(16)(MANY))
    assert cache.encoded == 0


def test_a_killed_writer_loses_at_most_its_last_chunk(tmp_path):
    worker = start_worker(tmp_path, 1, MANY)
    worker.stdin.write("go\n")
    worker.stdin.flush()
    done = int(worker.stdout.readline())
    worker.kill()
    worker.communicate()
    cache = CachedTextEncoder(Counting(), tmp_path)
    assert_same(cache(MANY), HashedTextEncoder(16)(MANY))
    assert cache.encoded <= len(MANY) - done


def test_a_reader_sees_what_another_wrote_after_it_opened(tmp_path):
    reader, writer = CachedTextEncoder(Counting(), tmp_path), CachedTextEncoder(Counting(), tmp_path)
    reader(TEXTS[:1])
    writer(TEXTS)
    assert_same(reader(TEXTS), HashedTextEncoder(16)(TEXTS))
    assert (reader.encoded, writer.encoded) == (1, len(TEXTS) - 1)


def test_half_precision_tokens_and_pooled_only(tmp_path):
    expected = HashedTextEncoder(16)(TEXTS)
    half = CachedTextEncoder(Counting(), tmp_path, tokens="float16")(TEXTS)
    assert half.tokens.dtype == torch.float32
    torch.testing.assert_close(half.tokens, expected.tokens, atol=2e-3, rtol=1e-3)
    torch.testing.assert_close(half.pooled, expected.pooled, atol=0, rtol=0)
    pooled = CachedTextEncoder(Counting(), tmp_path, tokens=None)(TEXTS)
    assert pooled.tokens is None
    torch.testing.assert_close(pooled.pooled, expected.pooled, atol=0, rtol=0)
    with pytest.raises(ValueError, match="int8"):
        CachedTextEncoder(Counting(), tmp_path, tokens="int8")


def test_pickled_cache_opens_its_folder_anew(tmp_path):
    cache = CachedTextEncoder(HashedTextEncoder(16), tmp_path)
    cache(TEXTS)
    raw = pickle.dumps(cache)
    assert len(raw) < 2000
    assert_same(pickle.loads(raw)(TEXTS), cache(TEXTS))


def test_unusable_texts_are_refused_before_anything_is_written(tmp_path):
    cache = CachedTextEncoder(Counting(), tmp_path)
    for texts in ([], ["walk", ""], "", [None], ["\ud83c"]):
        with pytest.raises(ValueError, match="text"):
            cache(texts)
    assert not (cache.folder / "index.bin").exists()
    assert cache("walk").texts == cache(["walk"]).texts == ["walk"]
