"""How the daemon fares: watched and judged once a second, remembered for hours; measuring never waits for it."""
