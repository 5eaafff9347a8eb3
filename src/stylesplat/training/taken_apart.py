"""A render's colours and some of its features, whose gradient is put together once.

By slices, each would fill a whole image with zeros first.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from jaxtyping import Float
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable


class _TakenApart(Function):
    @staticmethod
    def forward(ctx, render, rows, columns):
        ctx.shape, ctx.some = render.shape, (rows, columns)
        return render[..., :3].contiguous(), render[rows, columns, 3:].contiguous()

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors, v_features):
        v_render = v_colors.new_zeros(ctx.shape)
        v_render[..., :3] = v_colors
        v_render[*ctx.some, 3:] = v_features
        return v_render, None, None


def taken_apart(
    render: Float[Tensor, "H W D"], offset: tuple[int, int], stride: int
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "h w F"]]:
    """The colours, and what follows them at every n-th pixel along y and x.

    Args:
        render: Colours and features.
        offset: Row and column of the first pixel whose features are wanted.
        stride: The distance to the next.
    """
    y, x = offset
    return _TakenApart.apply(render, slice(y, None, stride), slice(x, None, stride))
