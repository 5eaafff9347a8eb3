"""What a recipe's YAML can be, and what never harms."""

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_yaml import MAX_YAML, parse_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: 1", 1),
        ("a: 1e-05", 1e-5),
        ("a: .5", 0.5),
        ("a: no", False),
        ("a: ", None),
        ("a: '3'", "3"),
        ("a: 2001-99-99", "2001-99-99"),
        ("a: 1:30", "1:30"),
        ("a: 007", "007"),
        ("a: [1, {b: c}]", [1, {"b": "c"}]),
        ("b: &b {c: 1}\na: *b", {"c": 1}),
        ('{"a": "\\ud83c\\udf0a"}', "🌊"),
    ],
)
def test_plain_values(text: str, value: object):
    for form in (text, *map(text.encode, ("utf-8", "utf-8-sig", "utf-16"))):
        found = parse_yaml(form)
        assert found["a"] == value and type(found["a"]) is type(value)


DOUBLING = "\n".join(
    ["a0: &a0 [x, x]", *(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]" for n in range(60))]
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: !!python/object/apply:os.system [ls]", "tags"),
        ("[" * 5000, "deep"),
        ("a: &a [*a]", "deep"),
        (DOUBLING, "too many|deep"),
        ("? [1]\n: 2", "a key is a list"),
        ("a: 1\na: 2", "a is listed twice"),
        ("<<: 3", "<< needs a mapping"),
        ("a: 1\n---\nb: 2", "another document"),
        ('a: "\\U99999999"', "no YAML text"),
        (b"a: \xff", "no YAML text"),
        ("a" * (MAX_YAML + 1), "longer than recipes"),
    ],
)
def test_what_is_refused(text: str | bytes, told: str):
    with pytest.raises(StyleSplatError, match=told) as caught:
        parse_yaml(text)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("text", ["a: " + "9" * 6000, "a: 1e999", "a: .inf"])
def test_numbers_without_bounds_are_infinite(text: str):
    assert parse_yaml(text)["a"] == float("inf")
