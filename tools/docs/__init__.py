"""The documentation site: generated reference, figures, and the blocks of its pages for the tests."""
