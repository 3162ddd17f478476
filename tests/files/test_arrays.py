"""NumPy's files are read only if they are what they say, and refused by one line that names them otherwise."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest

from kinema.files.arrays import Wanted, map_npy, read_npy, read_npz
from kinema.files.kinds import DamagedError

JOINTS = Wanted("f", (None, None, 3))


def npy(values, **options) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, **options)
    return stream.getvalue()


def header(text: str, content: bytes = b"", version: int = 1) -> bytes:
    raw = text.encode() + b"\n"
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(raw)) + raw + content


def archive(path, members, **options) -> None:
    with zipfile.ZipFile(path, "w", **options) as file:
        for name, content in members.items():
            file.writestr(name, content)


WALK = np.arange(24, dtype=np.float32).reshape(4, 2, 3)
WRONG = {
    "empty": (b"", "is empty"),
    "text": (b"a person walks\n", "is text"),
    "pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "Git LFS pointer"),
    "page": (b"<!DOCTYPE html><title>Quota exceeded</title>", "web page"),
    "bvh": (b"HIERARCHY\nROOT Hips\n", "BVH"),
    "zeros": (bytes(400), "nothing but zeros"),
    "archive": (b"PK\x03\x04" + bytes(40), "zip archive"),
    "pickle": (b"\x80\x04\x95", "pickle"),
    "cut in the magic": (b"\x93NUM", "unknown kind"),
    "cut in the header": (npy(WALK)[:40], "damaged header"),
    "cut in the values": (npy(WALK)[:-1], "cut off"),
    "too long": (npy(WALK) + b"\0", "cut off or changed"),
    "objects": (npy(np.array([{}], object), allow_pickle=True), "holds Python objects"),
    "complex": (npy(WALK.astype(complex)), "holds complex128"),
    "truth": (npy(WALK > 1), "holds bool"),
    "texts": (npy(np.array(["a"])), "holds <U1"),
    "integers": (npy(WALK.astype(int)), "holds int64, allowed: floats"),
    "two axes": (npy(WALK[0]), r"has shape \(2, 3\), allowed: \(any, any, 3\)"),
    "scalar": (npy(np.float32(1)), r"has shape \(\), allowed"),
    "wide": (npy(np.zeros((4, 2, 4), "f4")), r"has shape \(4, 2, 4\)"),
    "246 GiB": (
        header("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000, 22, 3), }"),
        "claims 264.0 GB .* there are 0 bytes",
    ),
    "negative": (header("{'descr': '<f4', 'fortran_order': False, 'shape': (-4, -2, 3), }", bytes(96)), "claims"),
    "code": (header("__import__('os').getcwd()"), "damaged header"),
    "deep": (header("(" * 5000 + ")" * 5000), "damaged header"),
    "brackets": (header("{'descr': '<f4', 'shape': (((, }"), "damaged header"),
    "long header": (header(" " * 60000), "damaged header"),
    "long header 2.0": (header(" " * 100000, version=2), "damaged header"),
    "header of 4 GB": (b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}", "damaged header"),
    "version 9": (b"\x93NUMPY\x09\x00" + bytes(100), "damaged header"),
    "subarray": (header("{'descr': ('<f4', (9,) * 3), 'shape': (1, 1, 3), 'fortran_order': False}"), "damaged header"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_npy_is_one_line_that_names_it(tmp_path, name):
    content, said = WRONG[name]
    (tmp_path / "walk.npy").write_bytes(content)
    for read in (read_npy, map_npy):
        with pytest.raises(DamagedError, match=rf"^\S*walk\.npy {'.*' if '.*' in said else ''}") as caught:
            read(tmp_path / "walk.npy", JOINTS)
        assert caught.match(said)
        assert "\n" not in str(caught.value)
        assert "unsafely" not in str(caught.value)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<f2"])
def test_an_array_comes_back_as_it_was(tmp_path, order, dtype):
    np.save(tmp_path / "walk.npy", np.asarray(WALK, dtype, order=order))
    np.savez(tmp_path / "walk.npz", joints=np.asarray(WALK, dtype, order=order))
    found = [read_npy(tmp_path / "walk.npy", JOINTS), map_npy(tmp_path / "walk.npy", JOINTS)]
    found += [read_npz(tmp_path / "walk.npz")["joints"]]
    for values in found:
        np.testing.assert_array_equal(values, WALK)
        assert values.dtype == dtype
    assert found[0].flags.writeable


def test_nothing_can_be_mapped(tmp_path):
    np.save(tmp_path / "none.npy", np.zeros((0, 22, 3), "f4"))
    assert map_npy(tmp_path / "none.npy", JOINTS).shape == read_npy(tmp_path / "none.npy", JOINTS).shape == (0, 22, 3)


def test_an_exact_dtype_is_asked_for(tmp_path):
    row = np.dtype([("offset", "<i8"), ("frames", "<i4")])
    np.save(tmp_path / "clips.npy", np.zeros(3, row))
    assert read_npy(tmp_path / "clips.npy", Wanted(row, (None,))).dtype == row
    with pytest.raises(DamagedError, match=r"holds .*offset.*allowed: int64"):
        read_npy(tmp_path / "clips.npy", Wanted(np.dtype("i8")))


@pytest.mark.parametrize("name", ["absent.npy", ""])
def test_what_is_no_file_is_missing(tmp_path, name):
    for read in (read_npy, map_npy, read_npz):
        with pytest.raises(FileNotFoundError, match=r"is missing|is a folder"):
            read(tmp_path / name)


def test_an_array_larger_than_allowed_is_not_read(tmp_path):
    np.save(tmp_path / "walk.npy", WALK)
    with pytest.raises(DamagedError, match="holds 96 bytes, allowed: 95 bytes"):
        read_npy(tmp_path / "walk.npy", most=95)


ARCHIVES = {
    "unpacks to too much": ({"joints.npy": npy(np.zeros(12_000_000, "u1"))}, "unpacks to 12.0 MB, allowed: 1.0 MB"),
    "claims too much": (
        {"joints.npy": header("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000, 22, 3), }")},
        "joints has a header that claims 264.0 GB",
    ),
    "objects": ({"joints.npy": npy(np.array([None]), allow_pickle=True)}, "joints holds Python objects"),
    "no array": ({"joints.npy": b"a person walks"}, "joints has a damaged header"),
    "another name": ({"poses.npy": npy(WALK)}, "holds no joints; it has poses"),
    "nothing": ({}, "holds no joints; it has nothing"),
    "flat": ({"joints.npy": npy(WALK[0])}, "joints has shape"),
}


@pytest.mark.parametrize("name", ARCHIVES)
def test_a_wrong_npz_is_one_line_that_names_it(tmp_path, name):
    members, said = ARCHIVES[name]
    archive(tmp_path / "walk.npz", members, compression=zipfile.ZIP_DEFLATED)
    shape = None if "much" in name else (None, None, 3)
    with pytest.raises(DamagedError, match=rf"walk\.npz.*{said}"):
        read_npz(tmp_path / "walk.npz", {"joints": Wanted("fu", shape)}, most=10**6)


@pytest.mark.parametrize("name", [n for n in WRONG if n not in ("archive",)])
def test_what_is_no_archive_is_one_line_that_names_it(tmp_path, name):
    (tmp_path / "walk.npz").write_bytes(WRONG[name][0])
    with pytest.raises(DamagedError, match=r"walk\.npz .*not an \.npz archive"):
        read_npz(tmp_path / "walk.npz")


def test_a_member_that_was_not_asked_for_may_be_anything(tmp_path):
    odd = npy(np.array(["male", None], object), allow_pickle=True)
    archive(tmp_path / "amass.npz", {"joints.npy": npy(WALK), "gender.npy": odd, "LICENSE": b"free"})
    found = read_npz(tmp_path / "amass.npz", {"joints": JOINTS, "text": Wanted("U", optional=True)})
    assert list(found) == ["joints"]
    with pytest.raises(DamagedError, match="gender holds Python objects"):
        read_npz(tmp_path / "amass.npz")


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_archive_is_refused_or_read_right(tmp_path, seed):
    draws = np.random.default_rng(seed)
    np.savez_compressed(tmp_path / "good.npz", joints=WALK, text=np.array("a person walks"))
    good = (tmp_path / "good.npz").read_bytes()
    refused = []
    for _ in range(50):
        content = bytearray(good[: draws.integers(1, len(good))] if draws.random() < 0.3 else good)
        for at in draws.integers(0, len(content), draws.integers(1, 4)):
            content[at] = draws.integers(256)
        (tmp_path / "walk.npz").write_bytes(content)
        try:
            found = read_npz(tmp_path / "walk.npz", {"joints": JOINTS})
        except DamagedError as error:
            refused.append(str(error))
        else:
            np.testing.assert_array_equal(found["joints"], WALK)
    assert len(refused) > 10
    assert all(said.startswith(f"{tmp_path}/walk.npz") and "\n" not in said for said in refused)
