"""Filters of the finished cloud: limits, smoothing, hole filling, downsampling, temporal fusion; all off by default."""
