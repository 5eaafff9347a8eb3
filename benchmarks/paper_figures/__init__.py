"""The figures of the StyleSplat paper, one module each, and what they share."""
