"""The viewer process: reads the stream like any other subscriber and shows it in Rerun; the daemon never imports it."""
