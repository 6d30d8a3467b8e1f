"""Programs that a person starts; the measuring daemon never imports them."""
