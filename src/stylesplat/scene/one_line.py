"""What Python prints of nouns: one line, in words and numbers, without reading a photo."""

from torch import Tensor

from stylesplat.errors import printable


def one_line(noun: object, *parts: object) -> str:
    """A noun with those of its parts that say something.

    Example:
        >>> one_line("", "3 Gaussians", None, "")
        'str(3 Gaussians)'
    """
    said = (printable(str(part)) for part in parts if part is not None)
    return f"{type(noun).__name__}({', '.join(filter(None, said))})"


def counted(count: int, what: str) -> str:
    """So many of something.

    Example:
        >>> counted(1, "photo"), counted(60_000, "Gaussian")
        ('1 photo', '60,000 Gaussians')
    """
    return f"{count:,} {what}{'s' * (count != 1)}"


def pixels(sizes: Tensor) -> str:
    """Widths and heights, one a row, as 540x960, or as the smallest and the largest."""
    known = sorted({(w, h) for w, h in sizes.tolist()}, key=lambda size: size[0] * size[1])
    return " to ".join(f"{w}x{h}" for w, h in dict.fromkeys((*known[:1], *known[-1:])))
