"""Options and the progress bar that commands share."""
