"""Where results go: clouds, manifests of finished chunks, and the lock of the folder."""
