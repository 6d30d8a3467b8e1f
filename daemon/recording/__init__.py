"""Takes on disk: MCAP files of raw pairs with everything needed to measure them again."""
