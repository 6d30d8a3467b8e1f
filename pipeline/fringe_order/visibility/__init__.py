"""Visibility: orders of strips that the other camera does not see, and of surfaces that claim one place there."""
