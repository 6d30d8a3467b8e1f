"""Reprocessing of recordings."""
