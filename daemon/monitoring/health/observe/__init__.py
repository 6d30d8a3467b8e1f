"""The quantities that health judges: frames, rates, light, clocks, the host."""
