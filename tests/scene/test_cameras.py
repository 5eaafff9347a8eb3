from dataclasses import replace

import pytest

from balls import CAMERAS
from stylesplat.errors import StyleSplatError

NAMED = replace(
    CAMERAS[:4], names=("left/IMG_1.jpg", "right/IMG_1.jpg", "right/IMG_2.jpg", "a.png")
)


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("right/IMG_1.jpg", 1),
        ("right/IMG_1", 1),
        ("right/IMG_1.HEIC", 1),
        ("IMG_2.jpg", 2),
        ("IMG_2", 2),
        ("a", 3),
    ],
)
def test_views_by_as_much_of_their_names_as_tells_them_apart(name: str, row: int):
    assert NAMED.index(name) == row


@pytest.mark.parametrize("name", ["IMG_1", "IMG_1.jpg", "IMG", "left", "b/a.png", ""])
def test_names_that_may_be_of_several_views_or_none(name: str):
    with pytest.raises(StyleSplatError, match="No view is called"):
        NAMED.index(name)


def test_a_name_in_another_case_gets_a_hint():
    with pytest.raises(StyleSplatError, match=r"Did you mean 'cam0/IMG_1\.JPG'\?"):
        replace(NAMED[:2], names=("cam0/IMG_1.JPG", "cam0/IMG_2.JPG")).index("cam0/img_1.jpg")
