"""Commands that measure, or show a measurement."""
