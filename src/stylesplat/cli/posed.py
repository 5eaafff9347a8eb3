"""Photos or a video where a capture is asked for: their poses are found first, once."""

from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io.folders import partial_of

SUFFIX = "-capture"  # what the capture of photos is called after their folder


def posed(given: Path, *, beside: Path) -> Path:
    """The capture that was given, or that of the photos or the video that were.

    A capture that an earlier command made of them is taken, where it lies beside them or beside
    `beside`; else `sfm` makes one beside `beside`.

    Raises:
        StyleSplatError: If poses cannot be found, or the photos have changed since they were.
    """
    from stylesplat.io.captures.capture_folder import is_posed

    if is_posed(given) or not given.exists():
        return given
    from stylesplat.progress import say
    from stylesplat.verbs.sfm import sfm

    found = earlier_capture(given, beside=beside)
    if found is not None:
        say(f"{given} has no camera poses: taking those in {found}.")
        return found
    output = place_of(given, beside=beside)
    say(f"{given} has no camera poses: finding them first, to be kept in {output}.")
    sfm(given, output)
    return output


def place_of(given: Path, *, beside: Path) -> Path:
    """Where the capture of photos or a video is made."""
    own = given.resolve()
    return beside.resolve().parent / f"{own.stem if own.is_file() else own.name}{SUFFIX}"


def earlier_capture(given: Path, *, beside: Path) -> Path | None:
    """The capture that was made of photos or a video, if there is one.

    Raises:
        StyleSplatError: If it was, but they have changed since.
    """
    from stylesplat.io.captures.sfm_file import read_sfm
    from stylesplat.verbs.sfm import digest_of

    for place in dict.fromkeys(place_of(given, beside=near) for near in (given, beside)):
        record = read_sfm(place)
        if record is not None and Path(record.source) == given.resolve():
            if record.digest == digest_of(given):
                return place
            raise StyleSplatError(
                f"The photos in {given} have changed since {place} was made of them. Make it "
                f"again with `stylesplat sfm {given} -o {place} --overwrite`, or use it as it is: "
                "name it in place of the photos."
            )
    return None


def is_under_way(given: Path, *, beside: Path) -> bool:
    """Whether poses are being found that `posed` would go on with."""
    return partial_of(place_of(given, beside=beside)).exists()
