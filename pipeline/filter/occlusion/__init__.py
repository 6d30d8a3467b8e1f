"""Occlusion: of two surfaces that claim one pixel of another device, one is rejected."""
