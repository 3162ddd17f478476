from __future__ import annotations

import copy

import numpy as np
import pytest
import torch

from kinema.motion.representation import Representation
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics

RNG = np.random.default_rng(0)
STATISTICS = Statistics.compute([RNG.normal(1, 2, size=(50, 263))], HUMANML3D)


@pytest.mark.parametrize(
    ("kind", "skeleton", "width", "groups"),
    [("essential", "humanml3d", 67, 4), ("redundant", "humanml3d", 263, 7), ("essential", "kit", 64, 4)],
)
def test_the_kind_chooses_the_columns(kind, skeleton, width, groups):
    representation = Representation(kind, skeleton)
    assert representation.width == width
    assert len(representation.groups) == groups
    assert max(c.stop for c in representation.groups.values()) == width


@pytest.mark.parametrize("kind", ["essential", "redundant"])
@pytest.mark.parametrize("variant", ["raw", "published"])
def test_denormalising_undoes_normalising_and_padding_is_zero(kind, variant):
    representation = Representation(kind, "humanml3d", variant).fit(STATISTICS)
    features = torch.from_numpy(RNG.normal(1, 2, size=(2, 6, 263))).float()
    features[1, 4:] = torch.nan
    lengths = torch.tensor([6, 4])
    normal = representation.normalize(features, lengths)
    assert normal.shape == (2, 6, representation.width)
    assert (normal[1, 4:] == 0).all()
    back = representation.denormalize(normal, lengths)
    expected = features[..., : representation.width].clone()
    expected[1, 4:] = 0
    torch.testing.assert_close(back, expected)


def test_the_published_variant_weighs_root_and_contacts_25_times():
    features = torch.from_numpy(RNG.normal(1, 2, size=(1, 3, 263))).float()
    raw, published = (Representation("redundant", "humanml3d", v).fit(STATISTICS) for v in ("raw", "published"))
    ratio = published.normalize(features) / raw.normalize(features)
    torch.testing.assert_close(ratio[0, 0, [0, 3, 4, 258, 259, 262]], torch.tensor([25.0, 25, 1, 1, 25, 25]))


def test_essential_columns_are_those_of_the_full_row():
    features = torch.from_numpy(RNG.normal(size=(2, 5, 263))).float()
    essential, redundant = (Representation(k, "humanml3d").fit(STATISTICS) for k in ("essential", "redundant"))
    torch.testing.assert_close(essential.normalize(features), redundant.normalize(features)[..., :67])
    torch.testing.assert_close(essential.normalize(features[..., :67]), essential.normalize(features))


def test_unfitted_use_is_refused_until_statistics_arrive_by_fit_or_weights():
    fitted = Representation("essential", "humanml3d").fit(STATISTICS)
    empty = Representation("essential", "humanml3d")
    for call in (empty.normalize, empty.denormalize):
        with pytest.raises(ValueError, match="no statistics"):
            call(torch.zeros(1, 2, 67))
    with pytest.raises(ValueError, match="no statistics"):
        empty.identity()
    empty.load_state_dict(fitted.state_dict())
    assert empty.identity() == fitted.identity()
    features = torch.ones(1, 2, 67)
    torch.testing.assert_close(empty.normalize(features), fitted.normalize(features))
    fitted.load_state_dict(Representation("essential", "humanml3d").state_dict())
    with pytest.raises(ValueError, match="no statistics"):
        fitted.normalize(features)


def test_the_identity_follows_the_statistics_and_survives_copies():
    raw, published = (Representation("redundant", "humanml3d", v).fit(STATISTICS) for v in ("raw", "published"))
    assert raw.identity()["digest"] != published.identity()["digest"]
    assert copy.deepcopy(raw).identity() == raw.identity()
    assert set(raw.state_dict()) == {"mean", "std"}


def test_narrow_input_is_refused():
    representation = Representation("redundant", "humanml3d")
    with pytest.raises(ValueError, match=r"67 columns.*needs 263"):
        representation.fit(Statistics(STATISTICS.mean[:67], STATISTICS.std[:67]))
    representation.fit(STATISTICS)
    with pytest.raises(ValueError, match=r"67 columns.*at least 263"):
        representation.normalize(torch.zeros(1, 2, 67))
    with pytest.raises(ValueError, match=r"67 columns.*has 263"):
        representation.denormalize(torch.zeros(1, 2, 67))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("full", "humanml3d"), "kind=full: must be one of essential, redundant"),
        (("essential", "smpl"), "skeleton=smpl: must be one of humanml3d, kit"),
        (("essential", "kit", "scaled"), "variant=scaled: must be one of raw, published"),
    ],
)
def test_unknown_choices_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Representation(*arguments)
