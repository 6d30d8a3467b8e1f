"""Commands that measure, or show what is being measured."""
