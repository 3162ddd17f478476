from __future__ import annotations

import numpy as np
import pytest

from kinema.motion.skeleton import HUMANML3D, KIT
from kinema.motion.statistics import Statistics


def chunks(width=263, sizes=(5, 1, 40), offset=0.0):
    rng = np.random.default_rng(0)
    return [(rng.normal(size=(n, width)) * np.linspace(1, 3, width) + offset).astype(np.float32) for n in sizes]


@pytest.mark.parametrize(("skeleton", "width"), [(HUMANML3D, 263), (HUMANML3D, 67), (KIT, 251)])
def test_statistics_are_those_of_all_rows_with_the_deviation_averaged_in_groups(skeleton, width):
    parts = chunks(width)
    rows = np.concatenate(parts).astype(np.float64)
    statistics = Statistics.compute([*parts, rows[:0]], skeleton)
    np.testing.assert_allclose(statistics.mean, rows.mean(0), rtol=1e-12)
    for columns in skeleton.groups.values():
        if columns.stop <= width:
            np.testing.assert_allclose(statistics.std[columns], rows.std(0)[columns].mean(), rtol=1e-12)


def test_a_far_off_mean_costs_no_precision():
    rows = np.concatenate(chunks()).astype(np.float64)
    shifted = Statistics.compute([rows[:20] + 1e6, rows[20:] + 1e6], HUMANML3D)
    np.testing.assert_allclose(shifted.std, Statistics.compute([rows], HUMANML3D).std, rtol=1e-8)


def test_the_published_variant_divides_root_and_contacts_by_25():
    raw = Statistics.compute(chunks(), HUMANML3D)
    ratio = raw.std / raw.published(HUMANML3D).std
    np.testing.assert_allclose(ratio[:4], 25)
    np.testing.assert_allclose(ratio[-4:], 25)
    np.testing.assert_allclose(ratio[4:-4], 1)


def test_a_constant_group_is_left_unscaled():
    part = chunks()[2]
    part[:, HUMANML3D.groups["contacts"]] = 1
    np.testing.assert_array_equal(Statistics.compute([part], HUMANML3D).std[-4:], 1)


def test_saving_round_trips_and_the_digest_follows_the_values(tmp_path):
    statistics = Statistics.compute(chunks(), HUMANML3D)
    statistics.save(tmp_path / "statistics.npz")
    loaded = Statistics.load(tmp_path / "statistics.npz")
    np.testing.assert_array_equal(loaded.mean, statistics.mean)
    np.testing.assert_array_equal(loaded.std, statistics.std)
    assert loaded.digest() == statistics.digest()
    assert loaded.published(HUMANML3D).digest() != statistics.digest()
    assert [p.name for p in tmp_path.iterdir()] == ["statistics.npz"]


def test_a_published_folder_loads(tmp_path):
    for name, value in (("Mean", 0.5), ("Std", 2.0)):
        np.save(tmp_path / f"{name}.npy", np.full(263, value, dtype=np.float32))
    assert Statistics.load(tmp_path).std[0] == 2


def test_bad_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"Mean\.npy is missing"):
        Statistics.load(tmp_path)
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04torn")
    with pytest.raises(ValueError, match=r"torn\.npz is a damaged archive"):
        Statistics.load(tmp_path / "torn.npz")
    np.savez(tmp_path / "other.npz", values=np.ones(3))
    with pytest.raises(ValueError, match=r"holds no mean, std; it has values"):
        Statistics.load(tmp_path / "other.npz")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([np.ones((3, 251))], r"chunk 0 has shape \(3, 251\)"),
        ([np.ones((3, 263)), np.full((2, 263), np.nan)], r"chunk 1 holds NaN"),
        ([], r"no rows"),
    ],
)
def test_bad_chunks_are_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        Statistics.compute(parts, HUMANML3D)


def test_non_positive_deviations_are_refused():
    with pytest.raises(ValueError, match="non-positive"):
        Statistics(np.zeros(4), np.zeros(4))
    with pytest.raises(ValueError, match="one length"):
        Statistics(np.zeros(4), np.ones(3))
