from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import torch
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from torch import Tensor

from type_checks import checked


@checked
def first(points: Float[Tensor, "N 3"], weights: Float[Tensor, "N"]) -> Float[Tensor, "N"]:
    return points[:, 0] if weights.sum() > 0 else weights[:0]


@checked
def rows(points: Float[Tensor, "N 3"], weights: Float[Tensor, "N"]) -> Iterator[Tensor]:
    for row in points:
        yield first(row[None], weights[:1])


@checked
@dataclass(frozen=True)
class Cloud:
    points: Float[Tensor, "N 3"]
    weights: Float[Tensor, "N"]

    @property
    @checked
    def heaviest(self) -> int:
        return self.weights.max()  # pyright: ignore[reportReturnType]


def ones(*shape: int) -> Tensor:
    return torch.ones(*shape)


@pytest.mark.parametrize("call", [first, rows, Cloud])
def test_shapes_are_checked_within_a_call(call):
    call(ones(4, 3), ones(4))
    call(ones(5, 3), ones(5))
    for points, weights in (
        (ones(4, 2), ones(4)),
        (ones(4, 3), ones(5)),
        (ones(4, 3).long(), ones(4)),
        (ones(4, 3).tolist(), ones(4)),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call(points, weights)


def test_results_are_checked():
    with pytest.raises(BeartypeCallHintViolation):
        first(ones(4, 3), -ones(4))
    with pytest.raises(BeartypeCallHintViolation):
        _ = Cloud(ones(4, 3), ones(4)).heaviest


def test_sizes_of_a_generator_are_its_own():
    @checked
    def outer(points: Float[Tensor, "N 3"]) -> list[Tensor]:
        return list(rows(points.repeat(2, 1), points.repeat(2, 1)[:, 0]))

    assert len(outer(ones(4, 3))) == 8


def test_what_is_tested_is_checked():
    from stylesplat.scene.splats import rgb_from_sh0

    with pytest.raises(BeartypeCallHintViolation):
        rgb_from_sh0([1.0])  # pyright: ignore[reportArgumentType]


def test_hints_of_what_is_not_there_are_left_out():
    @checked
    def later(there: "int", nowhere: "Nowhere") -> "Nowhere":  # pyright: ignore
        return nowhere

    assert later(1, 2) == 2
    assert later.__annotations__["nowhere"] == "Nowhere"
    with pytest.raises(BeartypeCallHintViolation):
        later("1", 2)
