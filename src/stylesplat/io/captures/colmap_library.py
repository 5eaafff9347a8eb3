"""pycolmap, whose logging takes SIGTERM and prints a stack: import it from here."""

from stylesplat.signals import kept_signals

with kept_signals():
    import pycolmap

__all__ = ["pycolmap"]
