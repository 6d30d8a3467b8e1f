"""A take's format on disk: MCAP records, raw images, names of parts, locks."""
