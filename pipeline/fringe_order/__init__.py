"""The fringe order of every pixel: candidates, semi-global aggregation, left-right check, propagation."""
