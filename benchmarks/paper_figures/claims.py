"""What the paper says, judged by what was measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from paper_figures import figure1, figure2, figure3, figure5, figure6, figure7, official, segmenting
from paper_figures.book import Results
from paper_figures.story import Table, digits, percent

CONFINED = 0.01  # of the pixels beyond 2 px at most, for a style that keeps to its object
CLEAR = 0.01  # of SSIM: what is a difference
NEAR = 0.02  # of mIoU: a threshold that is as good as the best
LESS = 0.1  # of what a loss in 2D changes, for a selection in 3D that keeps to its object
MOST = 0.5  # of the leakage with wrong masks, from which exact ones are to blame as well


@dataclass(frozen=True)
class Finding:
    """What one scene has to say of a claim."""

    holds: bool
    """Whether it is so."""
    numbers: str
    """By which numbers."""


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper's that numbers can contradict."""

    text: str
    """What it says."""
    judge: Callable[[Results], Finding | None]
    """What a scene says of it; None where it was not measured."""


def verdicts(results: Mapping[str, Results]) -> tuple[Table, Table]:
    """Which claims hold in which scene, and the numbers that say so.

    Args:
        results: By the scenes' names.
    """
    words, numbers = [], []
    for claim in CLAIMS:
        found = [claim.judge(each) for each in results.values()]
        if any(found):
            words.append([claim.text, *(_word(each) for each in found)])
            numbers.append([claim.text, *("" if each is None else each.numbers for each in found)])
    return Table(("the paper", *results), words), Table(("the paper", *results), numbers)


def _word(finding: Finding | None) -> str:
    if finding is None:
        return ""
    return "holds" if finding.holds else "**does not hold**"


def _leaks(results: Results) -> Finding | None:
    masked, lifted = _far(results, figure2.MASKED, 1), _far(results, figure2.LIFTED, 1)
    if masked is None or lifted is None:
        return None
    said = f"{percent(masked)} of the pixels beyond 2 px change, {percent(lifted)} in 3D"
    return Finding(lifted < LESS * masked, said)


def _masks_are_to_blame(results: Results) -> Finding | None:
    exact, wrong = _far(results, figure2.MASKED, 0), _far(results, figure2.MASKED, 1)
    if exact is None or wrong is None:
        return None
    said = f"{percent(exact)} beyond 2 px with exact masks, {percent(wrong)} with wrong ones"
    return Finding(exact < MOST * wrong, said)


def _damped(results: Results) -> Finding | None:
    """The same, once the optimiser is not to blame."""
    levels = [_far(results, figure2.DAMPED, level) for level in (0, 2)]
    if None in levels:
        return None
    exact, wrong = levels
    return Finding(
        exact < MOST * wrong, f"{percent(exact)}, and {percent(wrong)} at twice the error"
    )


def _far(results: Results, way: str, level: float) -> Any:
    found = results.get(figure2.NAME, {}).get(f"{way} at {level:g}")
    return None if found is None else found.numbers["changed_far"]


def _corrected(results: Results) -> Finding | None:
    found = _numbers(results, figure3.NAME, "label maps", "as trained")
    if found is None or found[0]["miou"] == 1:  # no exact maps: the given ones count as true
        return None
    given, trained = found[0]["miou"], found[1]["rendered labels"]["miou"]
    said = f"mIoU {digits(given)} of the given label maps, {digits(trained)} of rendered ones"
    return Finding(trained > given, said)


def _threshold(results: Results) -> Finding | None:
    trained = _numbers(results, figure3.NAME, "as trained")
    found = trained or _numbers(results, figure3.NAME, "lifted")
    if found is None:
        return None
    choices = {name: n["miou"] for name, n in found[0].items() if "removed" in name}
    best = max(choices, key=lambda name: choices[name])
    strict = choices[f"{0.95:g}, outliers removed"]
    said = f"mIoU {digits(strict)} at 0.95, {digits(choices[best])} at {best.split(',')[0]}"
    speed = _numbers(results, figure7.NAME, "speed")
    if not trained:
        said += ", identities lifted"
    elif speed:
        said += f", after {speed[0]['train_steps']:,} steps of training"
    return Finding(strict > choices[best] - NEAR, said)


def _outliers(results: Results) -> Finding | None:
    found = _numbers(results, figure3.NAME, "lifted")
    if found is None:
        return None
    name = f"{figure3.THRESHOLD:g}, outliers"
    kept, removed = (found[0][f"{name} {what}"]["miou"] for what in ("kept", "removed"))
    return Finding(removed >= kept, f"mIoU {digits(removed)} without outliers, {digits(kept)} with")


def _confined(results: Results) -> Finding | None:
    shares = [
        result.numbers["changed_far"]
        for key, result in results.get(figure1.NAME, {}).items()
        if key.endswith(", paper")
    ]
    if not shares:
        return None
    said = f"at most {percent(max(shares))} of the pixels beyond 2 px change"
    return Finding(max(shares) <= CONFINED, said)


def _content(results: Results) -> Finding | None:
    found = _numbers(results, figure2.NAME, f"{figure2.LIFTED} at 1", f"{figure2.MASKED} at 1")
    if found is None:
        return None
    ours, masked = (n["content_ssim"] for n in found)
    return Finding(
        ours > masked + CLEAR, f"SSIM {digits(ours)}, {digits(masked)} with the loss in 2D"
    )


def _together(results: Results) -> Finding | None:
    found = [result.numbers for result in results.get(figure5.NAME, {}).values()]
    if not found:
        return None
    other = sum(sum(n["differing"].values()) for n in found)
    elsewhere = sum(n["changed_elsewhere"] for n in found)
    said = (
        f"{other:,} of their Gaussians differ from those painted alone, {elsewhere:,} others change"
    )
    return Finding(other == elsewhere == 0, said)


def _by_scale(results: Results) -> Finding | None:
    return _trend(results, "scale", "stroke", 1)


def _by_layers(results: Results) -> Finding | None:
    return _trend(results, "layers", "stroke", -1)


def _by_rate(results: Results) -> Finding | None:
    return _trend(results, "rate", "strength", 1)


def _trend(results: Results, axis: str, measure: str, expected: int) -> Finding | None:
    along = figure6.along(results, axis)
    values = [numbers[measure] for numbers in along.values()]
    if len(values) < 3:
        return None
    unit = " px" if measure == "stroke" else " in Lab"
    said = f"{axis}: {measure} {', '.join(digits(v, 2) for v in values)}{unit}"
    return Finding(figure6.trend(values) == expected, said)


def _formula(results: Results) -> Finding | None:
    found = _numbers(results, official.NAME, official.PRINTED, "none")
    if found is None:
        return None
    printed, meant = (n["nnfm"] for n in found)
    return Finding(
        printed <= meant, f"NNFM {digits(printed)} with it, {digits(meant)} with ARF's formula"
    )


def _neighbours(results: Results) -> Finding | None:
    return _segmented(results, segmenting.WITHOUT)


def _lifting(results: Results) -> Finding | None:
    return _segmented(results, segmenting.LIFTED)


def _segmented(results: Results, other: str) -> Finding | None:
    found = _numbers(results, segmenting.NAME, segmenting.JOINT, other)
    if found is None:
        return None
    joint, rest = (n["miou"] for n in found)
    said = f"mIoU {digits(joint)}, {digits(rest)} {other.removeprefix('joint, ')}"
    return Finding(joint >= rest, said)


def _numbers(results: Results, figure: str, *keys: str) -> list[Any] | None:
    """What cells found; None if one is not there."""
    found = results.get(figure, {})
    return [found[key].numbers for key in keys] if all(key in found for key in keys) else None


CLAIMS: Sequence[Claim] = (
    Claim(
        "A loss masked in 2D changes other parts of the scene; a selection in 3D does not.", _leaks
    ),
    Claim("The loss does so because masks have errors.", _masks_are_to_blame),
    Claim("The same claim, with a larger epsilon in Adam (see Figure 2).", _damped),
    Claim("Identities learned from many noisy label maps correct their errors.", _corrected),
    Claim("A threshold of 0.95 (in its code) chooses the object's Gaussians.", _threshold),
    Claim("Removing statistical outliers improves the selection.", _outliers),
    Claim("The style stays on the selected object.", _confined),
    Claim("A selection in 3D keeps more content than a loss masked in 2D.", _content),
    Claim(
        "Two objects painted together equal those painted alone; nothing else changes.", _together
    ),
    Claim("A smaller style picture repeats its pattern more often.", _by_scale),
    Claim("Deeper layers act like a smaller style picture.", _by_layers),
    Claim("A larger learning rate gives a stronger style.", _by_rate),
    Claim(
        "Minimising its formula, the smallest product of features, transfers the style.", _formula
    ),
    Claim("A term that keeps neighbours together makes objects more exact.", _neighbours),
    Claim("Identities are learned with the colours: lifting them is no better.", _lifting),
)
