"""How strong a style may be; apart from tensors, for what is to start at once."""

from stylesplat.errors import StyleSplatError

MAX_INTENSITY = 1.5  # beyond it colours leave their range
MAX_FORM = 1.5  # likewise


def check_intensity(intensity: float) -> None:
    """Raise a StyleSplatError if colours cannot be blended so."""
    if not 0 <= intensity <= MAX_INTENSITY:
        raise StyleSplatError(f"Cannot blend with intensity {intensity}: use 0 to {MAX_INTENSITY}.")


def check_form(form: float) -> None:
    """Raise a StyleSplatError if so much relief cannot be shown."""
    if not 0 <= form <= MAX_FORM:
        raise StyleSplatError(f"Cannot show the form {form}: use 0 to {MAX_FORM}.")
