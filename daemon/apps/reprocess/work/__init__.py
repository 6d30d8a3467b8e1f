"""What one task computes: the clouds of a chunk, from the state that the chunks before left."""
