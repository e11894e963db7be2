"""Synthetic surfaces: gratings, discs, bumps and fingers of known shape."""

from warpdiff.surface.gratings import blazed, bumps, disc, fingers, lamellar, sinusoidal

__all__ = ["blazed", "bumps", "disc", "fingers", "lamellar", "sinusoidal"]
