from dataclasses import replace

import torch

from balls import SPLATS
from scenes import random_splats
from stylesplat.training.state import CLASSIFIER, first_state


def test_splats_come_back():
    state = first_state(SPLATS)
    for name, tensor in SPLATS.tensors().items():
        assert torch.equal(state.splats.tensors()[name], tensor)
    classifier = state.splats.classifier
    assert classifier is not None and SPLATS.classifier is not None
    assert torch.equal(classifier.weight, SPLATS.classifier.weight)
    assert classifier.ids == state.ids == SPLATS.classifier.ids


def test_nothing_is_shared_with_the_splats():
    before = random_splats(5)
    state = first_state(before)
    with torch.no_grad():
        state.params["means"].zero_()
    assert before.means.any()


def test_a_first_state_is_contiguous_whatever_the_splats_are():
    splats = random_splats(5)
    state = first_state(replace(splats, means=splats.means.T.contiguous().T))
    assert torch.equal(state.params["means"], splats.means)
    tensors = (state.params, state.moments.first, state.moments.second)
    assert all(tensor.is_contiguous() for each in tensors for tensor in each.values())


def test_a_first_state_has_done_nothing():
    state = first_state(random_splats(5))
    assert (state.step, state.seconds, state.first_count) == (0, 0.0, 5)
    moments = [*state.moments.first.values(), *state.moments.second.values()]
    assert not any(tensor.any() for tensor in moments)
    assert all(tensor.requires_grad for tensor in state.params.values())


def test_the_classifier_has_no_row_per_gaussian():
    state = first_state(SPLATS)
    assert set(state.params) - set(state.names) == set(CLASSIFIER)
    assert all(len(state.params[name]) == len(SPLATS) for name in state.names)


def test_without_identities_there_is_no_classifier():
    plain = replace(SPLATS, identities=None, classifier=None)
    state = first_state(plain)
    assert state.ids == () and state.splats.classifier is None
    assert not set(CLASSIFIER) & set(state.params)


def test_clones_share_nothing():
    state = first_state(random_splats(5))
    copy = state.clone()
    with torch.no_grad():
        for name in copy.params:
            copy.params[name].fill_(7)
            copy.moments.first[name].fill_(7)
            copy.moments.second[name].fill_(7)
    assert not any((tensor == 7).all() for tensor in state.params.values())
    assert not any(tensor.any() for tensor in state.moments.first.values())
    assert not any(tensor.any() for tensor in state.moments.second.values())


def test_splats_stay_attached_to_what_is_trained():
    state = first_state(random_splats(5))
    state.splats.means.sum().backward()
    gradient = state.params["means"].grad
    assert gradient is not None and torch.equal(gradient, torch.ones(5, 3))
