"""The one-line representations of nouns, made without reading a photo."""

from torch import Tensor

from stylesplat.errors import printable


def one_line(noun: object, *parts: object) -> str:
    texts = (printable(str(part)) for part in parts if part is not None)
    return f"{type(noun).__name__}({', '.join(filter(None, texts))})"


def counted(count: int, what: str) -> str:
    """A number and its noun, such as '1 photo' or '60,000 Gaussians'."""
    return f"{count:,} {what}{'s' * (count != 1)}"


def pixels(sizes: Tensor) -> str:
    """Rows of width and height as '540x960', or as the smallest 'to' the largest."""
    known = sorted({(w, h) for w, h in sizes.tolist()}, key=lambda size: size[0] * size[1])
    return " to ".join(f"{w}x{h}" for w, h in dict.fromkeys((*known[:1], *known[-1:])))
