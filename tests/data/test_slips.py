"""Every line of a caption file is read as written, or told with file, line and fix: by prepare and by the doctor."""

from __future__ import annotations

import codecs

import pytest

from kinema.data.captions import AnnotatedCaption
from kinema.data.catalog import read_joints_folder
from kinema.data.doctor import diagnose, format
from kinema.data.prepare import prepare
from kinema.data.slips import EMPTY, REPEATED, REPLACED, UNREADABLE, UNTAGGED, read_captions
from kinema.data.store import PackedStore
from kinema.types import Caption

BARE = [AnnotatedCaption(Caption(text)) for text in ("elle démarre", "a man jumps")]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    ("mark", "encoding"),
    [
        (b"", "utf-8"),
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
    ],
)
def test_an_encoding_that_says_so_is_read(tmp_path, mark, encoding, end):
    (tmp_path / "a.txt").write_bytes(mark + end.join(("elle démarre", "a man jumps", "")).encode(encoding))
    assert read_captions(tmp_path, "a.txt") == (BARE, [])


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "cp850", "mac-roman"])
def test_a_line_in_another_encoding_is_left_out_and_its_byte_named(tmp_path, encoding):
    (tmp_path / "a.txt").write_bytes("a man jumps\nelle démarre\n".encode(encoding))
    captions, (slip,) = read_captions(tmp_path, "a.txt")
    assert captions == BARE[1:]
    assert slip.flaw is UNREADABLE
    byte = "é".encode(encoding)[0]
    assert str(slip).startswith(f"a.txt, line 2: byte 0x{byte:02x} in column 7 is not UTF-8, after 'elle d'; save")


@pytest.mark.parametrize(
    ("content", "flaws"),
    [
        (b"", []),
        (b"a man jumps\n\n\n", []),
        (b"\n\na man jumps\n", [(1, EMPTY), (2, EMPTY)]),
        (b"a man jumps\n \na man runs\n", [(2, EMPTY)]),
        (b"a man jumps\na man runs\na man jumps\n", [(3, REPEATED)]),
        (b"a man jumps##0#0\na man jumps\na man jumps##1#2\n", [(2, REPEATED)]),
        (b"a man jumps#a man jump#0.0#0.0\n", [(1, UNTAGGED)]),
        (b"a man jumps#a/DET man jump/VERB#0.0#0.0\n", [(1, UNTAGGED)]),
        ("the d\ufffdbut\n".encode(), [(1, REPLACED)]),
        ("the debut#the/DET d\ufffdbut/NOUN#0#0\n".encode(), [(1, REPLACED)]),
        (b"#a/DET#0#0\na man jumps", [(1, UNREADABLE)]),
        (b"a man jumps\n##0.0#0.0", [(2, UNREADABLE)]),
        (b"a man jumps##0#soon\n", [(1, UNREADABLE)]),
        ("a man\n".encode("utf-16-le"), [(1, UNREADABLE), (2, UNREADABLE)]),
        ("a man".encode("utf-32"), [(1, UNREADABLE)]),
        (codecs.BOM_UTF16_LE + b"abc", [(1, UNREADABLE)]),
        (b"a\0man\na man jumps", [(1, UNREADABLE)]),
    ],
)
def test_what_is_wrong_is_told_by_line(tmp_path, content, flaws):
    (tmp_path / "a.txt").write_bytes(content)
    assert [(slip.line, slip.flaw) for slip in read_captions(tmp_path, "a.txt")[1]] == flaws


LINES = {
    "set #3 of jumps\n": None,
    "walks#a person walk#0.0#0.0\n": "untagged tokens",
    "walks\nwalks\n": "repeated captions",
    "walks\n\nruns\n": "empty lines",
    "d\ufffdmarre\n": "replaced characters",
    "walks\nwalks##0#soon\n": "unreadable captions",
}


@pytest.mark.parametrize(("text", "finding"), LINES.items())
def test_prepare_and_doctor_tell_file_and_line_before_anything_trains(joints_corpus, tmp_path, capsys, text, finding):
    clips = {f"{split}{i}": (split, 61) for split in ("train", "val", "test") for i in range(2)}
    source = joints_corpus({**clips, "odd": ("train", 61, text)})
    capsys.readouterr()
    store = PackedStore.open(prepare(read_joints_folder(source), tmp_path / "store", name="odd", mirror=False))
    prepared = capsys.readouterr().out
    (odd,) = (e for e in range(store.num_entries) if store.entry_name(e) == "odd")
    assert all(not c.tokens for c in store.entry_captions(odd))
    for examined in (diagnose(source), diagnose(store, source=source)):
        found = {f.kind: f for f in examined}
        if finding is None:
            assert store.entry_captions(odd) == [Caption("set #3 of jumps")]
            assert not any("odd" in item for f in examined for item in f.items if f.kind.endswith("captions"))
        else:
            assert any("texts/odd.txt, line " in item for item in found[finding].items)
            assert found[finding].fix in format(examined)
    assert ("texts/odd.txt, line " in prepared) is (finding is not None)


def test_a_corpus_of_which_most_captions_cannot_be_read_is_refused(joints_corpus):
    clips = {f"{split}{i}": (split, 61) for split in ("train", "val", "test") for i in range(2)}
    source = joints_corpus(clips)
    for file in (source / "texts").glob("t*.txt"):
        file.write_bytes("une personne d\u00e9marre\nelle s'arr\u00eate\n".encode("cp1252"))
    with pytest.raises(ValueError, match=r"8 of 12 caption lines cannot be read \(first, texts/.*line 1: byte 0xe9"):
        read_joints_folder(source)
    assert "caption lines cannot be read" in format(diagnose(source))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("train0\ntrès\n".encode("cp1252"), r"train.txt, line 2: byte 0xe8 in column 3 is not UTF-8"),
        ("train0\n".encode("utf-16-le"), r"train.txt, line 1: it holds zero bytes"),
    ],
)
def test_a_list_of_clips_in_another_encoding_is_named_by_its_line(joints_corpus, content, says):
    source = joints_corpus({"train0": ("train", 61), "val0": ("val", 61), "test0": ("test", 61)})
    (source / "train.txt").write_bytes(content)
    with pytest.raises(ValueError, match=says):
        read_joints_folder(source)
    assert "train.txt, line " in format(diagnose(source))
