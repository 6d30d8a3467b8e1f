"""Reading of takes: parts, catalogue and inspection."""
