"""pycolmap, whose logging takes SIGTERM and prints a stack: import it from here."""

from stylesplat.interrupts import preserve_signal_handlers

with preserve_signal_handlers():
    import pycolmap

__all__ = ["pycolmap"]
