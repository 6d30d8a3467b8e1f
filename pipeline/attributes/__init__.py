"""Attributes of the points of a cloud, computed from the cloud itself: normals."""
