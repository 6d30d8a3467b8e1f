"""Takes read: their parts, catalogue and inspection."""
