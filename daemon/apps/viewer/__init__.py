"""The viewer process, a subscriber of the stream that shows it in Rerun; never imported by the daemon."""
