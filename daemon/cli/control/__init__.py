"""Commands that ask a running daemon, or tell it something."""
