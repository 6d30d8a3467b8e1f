"""The monitored quantities: frames, counter rates, illumination, clocks, the host."""
